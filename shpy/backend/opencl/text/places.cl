// Combine the values of each place in their order: the first is stored, and each later one is combined with the result
// so far. `seen` has a byte for each place. A negative index is out of range as an unsigned one.
__kernel void sh_places(ulong count, ulong places, __global const uint *index, __global uchar *seen, VALUES, RESULTS) {
    for (ulong k = 0; k < places; k += 1) {
        seen[k] = 0;
    }
    for (ulong i = 0; i < count; i += 1) {
        uint at = index[i];
        if (at >= places) {
            continue;
        }
        if (seen[at]) {
            COMBINE
        } else {
            seen[at] = 1;
            STORE
        }
    }
}
