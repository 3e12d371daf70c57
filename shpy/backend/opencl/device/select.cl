__kernel void count_marks(__global const uchar *marks, uint n, uint chunk, __global uint *counts) {
    uint first = get_global_id(0) * chunk, end = min(n, first + chunk), count = 0, i = first;
    for (; i + 16 <= end; i += 16) {
        // A mark that is set gives -1.
        char16 set = vload16(0, marks + i) != (uchar16)(0);
        char8 eight = set.lo + set.hi;
        char4 four = eight.lo + eight.hi;
        count -= (int)four.x + four.y + four.z + four.w;
    }
    for (; i < end; ++i)
        count += marks[i] != 0;
    counts[get_global_id(0)] = count;
}

__kernel void list_marks(__global const uchar *marks, uint n, uint chunk, __global const uint *starts,
                         __global int *listed) {
    uint first = get_global_id(0) * chunk, end = min(n, first + chunk);
    __global int *to = listed + starts[get_global_id(0)];
    int some[BLOCK];
    for (uint begin = first; begin < end; begin += BLOCK) {
        uint stop = min(end, begin + BLOCK), count = 0;
        // Each index is stored, and the next one overwrites it where it is not marked: no branch is mispredicted.
        for (uint i = begin; i < stop; ++i) {
            some[count] = i;
            count += marks[i] != 0;
        }
        for (uint k = 0; k < count; ++k)
            to[k] = some[k];
        to += count;
    }
}
