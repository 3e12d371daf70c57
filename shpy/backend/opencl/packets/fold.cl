// The tree over two packets of which `left` elements count: an odd last one passes unchanged.
INLINE sh_node sh_halve(sh_node a, sh_node b, int left) {
    sh_node even = sh_even(a, b);
    sh_node both = sh_combine(even, sh_odd(a, b));
    return left & 1 ? sh_chosen(sh_lanes() == left / 2, even, both) : both;
}

// The tree over a part of a block, in the first lane: of `left` elements from `first` on.
INLINE sh_node sh_tree(GIVEN, ulong first, int left) {
    sh_node node[BLOCK / (2 * WIDTH)];
    int pairs = left / (2 * WIDTH), rest = left % (2 * WIDTH);
    for (int k = 0; k < pairs; k += 1) {
        ulong at = first + k * (2 * WIDTH);
        node[k] = sh_neighbours(sh_given(GIVEN_ARGS, at, at + WIDTH), sh_given(GIVEN_ARGS, at + WIDTH, at + 2 * WIDTH));
    }
    if (rest != 0) {
        ulong at = first + left - rest, end = first + left;
        sh_node a = sh_given(GIVEN_ARGS, at, end), b = a;
        if (rest > WIDTH) {
            b = sh_given(GIVEN_ARGS, at + WIDTH, end);
        }
        node[pairs] = sh_halve(a, b, rest);
    }
    for (left = (left + 1) / 2; left > 1; left = (left + 1) / 2) {
        int pairs = left / (2 * WIDTH), rest = left % (2 * WIDTH);
        for (int k = 0; k < pairs; k += 1) {
            node[k] = sh_neighbours(node[2 * k], node[2 * k + 1]);
        }
        if (rest != 0) {
            node[pairs] = sh_halve(node[2 * pairs], node[2 * pairs + (rest > WIDTH)], rest);
        }
    }
    return node[0];
}

// The tree over a block, up to the level that is one packet.
INLINE sh_node sh_whole(GIVEN, ulong first) {
    sh_node node[BLOCK / LOWEST];
    for (int k = 0; k < BLOCK / LOWEST; k += 1) {
        node[k] = sh_lowest(GIVEN_ARGS, first + k * LOWEST);
    }
    for (int width = BLOCK / LOWEST / 2; width > 0; width /= 2) {
        for (int k = 0; k < width; k += 1) {
            node[k] = sh_neighbours(node[2 * k], node[2 * k + 1]);
        }
    }
    return node[0];
}

// The tree over elements. `waiting` holds a packet for each bit of the number of whole blocks that are done.
INLINE sh_node sh_range(GIVEN, ulong at, ulong end) {
    sh_node waiting[64], made;
    uint blocks = 0;
    for (; at + BLOCK <= end; at += BLOCK) {
        int level = 0;
        made = sh_whole(GIVEN_ARGS, at);
        for (uint done = blocks; done & 1; done >>= 1) {
            made = sh_neighbours(waiting[level], made);
            level += 1;
        }
        waiting[level] = made;
        blocks += 1;
    }
    bool some = at < end;
    if (some) {
        made = sh_tree(GIVEN_ARGS, at, (int)(end - at));
    }
    for (int level = 0; blocks >> level != 0; level += 1) {
        if (blocks >> level & 1) {
            sh_node whole = waiting[level];
            for (int lanes = WIDTH; lanes > 1; lanes /= 2) {
                whole = sh_neighbours(whole, whole);
            }
            made = some ? sh_combine(whole, made) : whole;
            some = true;
        }
    }
    return made;
}

// Combine a node with those that wait for it. `waiting` holds a node for each bit of the number of those `before`.
INLINE void sh_wait(sh_node *waiting, uint before, sh_node made) {
    int level = 0;
    for (; before & 1; before >>= 1) {
        made = sh_combine(waiting[level], made);
        level += 1;
    }
    waiting[level] = made;
}

// The tree over the nodes of parts, in each lane.
INLINE sh_node sh_joined(MADE, uint parts) {
    sh_node waiting[32], made;
    for (uint part = 0; part < parts; part += 1) {
        sh_wait(waiting, part, sh_first(sh_made(MADE_ARGS, part, part + 1)));
    }
    bool some = false;
    for (int level = 0; parts >> level != 0; level += 1) {
        if (parts >> level & 1) {
            made = some ? sh_combine(waiting[level], made) : waiting[level];
            some = true;
        }
    }
    return made;
}

// The tree over each part of `each` elements. `done` counts the finished parts: the work item that finishes the last
// one continues with the tree over all parts, and resets the counter to 0. Without `done` the parts are all that it
// makes: OpenCL 1.2 does not promise that a work group sees what another one has stored.
__kernel void sh_fold(GIVEN, ulong count, ulong each, MADE, __global volatile uint *done, OUT) {
    ulong part = get_global_id(0), at = part * each;
    uint parts = get_global_size(0);
    sh_write(MADE_ARGS, sh_range(GIVEN_ARGS, at, min(count, at + each)), part, part + 1);
    if (done) {
        mem_fence(CLK_GLOBAL_MEM_FENCE);
        if (atomic_inc(done) == parts - 1) {
            mem_fence(CLK_GLOBAL_MEM_FENCE);
            *done = 0;
            sh_write(OUT_ARGS, sh_joined(MADE_ARGS, parts), 0, 1);
        }
    }
}
