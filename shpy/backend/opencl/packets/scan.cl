// The prefixes of the even nodes of a level: each combines the prefix of the odd node before it with its own value.
// `through` are the prefixes of the odd nodes, and `before` ends with the prefix before them.
INLINE sh_node sh_evens(sh_node before, sh_node through, sh_node even, bool begins) {
    sh_node both = sh_combine(sh_after(before, through), even);
    return begins ? sh_chosen(sh_lanes() == 0, even, both) : both;
}

// Fills the levels above the packets of a block and returns the last level. Nodes after the last element are undefined.
INLINE sh_node *sh_up(sh_node *level, int packets) {
    for (int width = BLOCK / WIDTH; width > 1; width /= 2) {
        for (int k = 0; 2 * k < packets; k += 1) {
            level[width + k] = sh_neighbours(level[2 * k], level[min(2 * k + 1, packets - 1)]);
        }
        level += width;
        packets = (packets + 1) / 2;
    }
    for (int lanes = WIDTH; lanes > 1; lanes /= 2) {
        level[1] = sh_neighbours(level[0], level[0]);
        level += 1;
    }
    return level;
}

// Replace the nodes of all levels by their prefixes, from the last one on. `before` is the prefix that ends before
// the block, unless the block `begins` the stream, and `through` the one that ends with it.
INLINE void sh_down(sh_node *level, int packets, sh_node before, sh_node through, bool begins) {
    *level = through;
    for (int lanes = WIDTH; lanes > 1; lanes /= 2) {
        level -= 1;
        level[0] = sh_low(sh_evens(before, level[1], sh_even(level[0], level[0]), begins), level[1]);
    }
    for (int width = 2; width <= BLOCK / WIDTH; width *= 2) {
        sh_node *parents = level, last = before;
        int under = BLOCK / WIDTH / width, here = (packets + under - 1) / under;
        level -= width;
        for (int k = 0; 2 * k < here; k += 1) {
            sh_node parent = parents[k], even = sh_even(level[2 * k], level[min(2 * k + 1, here - 1)]);
            even = sh_evens(last, parent, even, begins && k == 0);
            level[2 * k] = sh_low(even, parent);
            level[2 * k + 1] = sh_high(even, parent);
            last = parent;
        }
    }
}

// The prefixes of `each` elements, shifted by one place if `exclusive`. If there are several parts of `each` elements,
// `above` holds the prefix that ends with each part.
__kernel void sh_scan(GIVEN, ulong count, ulong each, int parts, int exclusive, ABOVE, OUT) {
    ulong part = get_global_id(0), first = part * each, end = min(count, first + each);
    sh_node node[2 * BLOCK / WIDTH + 4], waiting[64], outer = sh_nothing();
    uint blocks = 0;
    if (part > 0) {
        outer = sh_first(sh_given(ABOVE_ARGS, part - 1, part));
    }
    if (part == 0 && exclusive) {
        sh_write(OUT_ARGS, outer, 0, 1);
    }
    sh_node before = outer;
    for (ulong at = first; at < end; at += BLOCK) {
        int left = (int)min(end - at, (ulong)BLOCK), packets = (left + WIDTH - 1) / WIDTH;
        for (int k = 0; k < packets; k += 1) {
            node[k] = sh_given(GIVEN_ARGS, at + k * WIDTH, count);
        }
        sh_node *root = sh_up(node, packets), through = outer;
        sh_wait(waiting, blocks, *root);
        blocks += 1;
        bool some = part > 0;
        for (int level = 31 - clz(blocks); level >= 0; level -= 1) {
            if (blocks >> level & 1) {
                through = some ? sh_combine(through, waiting[level]) : waiting[level];
                some = true;
            }
        }
        through = sh_first(parts > 1 && at + BLOCK == first + each ? sh_given(ABOVE_ARGS, part, part + 1) : through);
        sh_down(root, packets, before, through, at == 0);
        for (int k = 0; k < packets; k += 1) {
            sh_write(OUT_ARGS, node[k], at + k * WIDTH + exclusive, count);
        }
        before = through;
    }
}
