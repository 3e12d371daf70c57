// `last` is the greatest key, where keys have a bound: the others are clamped. A digit is one of `radix`, at most MOST.
// Loops over digits that change a table are not unrolled: equal digits often follow each other, and processors foresee
// that an instruction reads what it has just written.
inline WORD key(WORD x, uint last) {
    return KEY;
}

// Compute the digits of up to BLOCK keys from `first` on; return how many there are. A processor does so in vectors.
inline uint digits(__global const WORD *given, uint first, uint end, uint shift, uint radix, uint last, uint *digit) {
    uint count = min(end - first, (uint)BLOCK);
    for (uint k = 0; k < count; ++k)
        digit[k] = (key(given[first + k], last) >> shift) & (radix - 1);
    return count;
}

__kernel void count_digits(__global const WORD *given, uint n, uint chunk, uint shift, uint radix, uint last,
                           __global uint *counts) {
    uint first = get_global_id(0) * chunk, end = min(n, first + chunk), i = first;
    // A row for each chunk: if the counts of a digit were neighbours, threads would write to the same cache lines.
    __global uint *own = counts + get_global_id(0) * radix;
    uint more[3][MOST];
    for (uint d = 0; d < radix; ++d)
        own[d] = more[0][d] = more[1][d] = more[2][d] = 0;
    // Equal digits often follow each other: four tables let four be counted at a time.
    for (; i + 4 <= end; i += 4) {
        ++own[(key(given[i], last) >> shift) & (radix - 1)];
        ++more[0][(key(given[i + 1], last) >> shift) & (radix - 1)];
        ++more[1][(key(given[i + 2], last) >> shift) & (radix - 1)];
        ++more[2][(key(given[i + 3], last) >> shift) & (radix - 1)];
    }
    for (; i < end; ++i)
        ++own[(key(given[i], last) >> shift) & (radix - 1)];
    for (uint d = 0; d < radix; ++d)
        own[d] += more[0][d] + more[1][d] + more[2][d];
}

// Replace each count by the sum of those of lower digits, and of this digit in the chunks before.
__kernel void sum_before(__global uint *counts, uint radix, uint chunks) {
    uint sum = 0;
    for (uint d = 0; d < radix; ++d)
        for (uint c = 0; c < chunks; ++c) {
            uint count = counts[c * radix + d];
            counts[c * radix + d] = sum;
            sum += count;
        }
}

// Move the elements from `first` to before `end` to the places that `at` has for their digits: the words unless only
// their indices are wanted, and the indices that they had at first where these are wanted. Without `indices`, an index is
// where a word stands.
inline void move_chunk(__global const WORD *given, uint first, uint end, uint shift, uint radix, uint last, uint *at,
                       __global WORD *moved, __global const uint *indices, __global uint *moved_indices) {
    uint digit[BLOCK];
    for (uint i = first; i < end; i += BLOCK) {
        uint count = digits(given, i, end, shift, radix, last, digit);
#pragma unroll 1
        for (uint k = 0; k < count; ++k) {
            uint to = at[digit[k]]++;
            if (moved)
                moved[to] = given[i + k];
            if (moved_indices)
                moved_indices[to] = indices ? indices[i + k] : i + k;
        }
    }
}

__kernel void move_digits(__global const WORD *given, uint n, uint chunk, uint shift, uint radix, uint last,
                          __global const uint *counts, __global WORD *moved, __global const uint *indices,
                          __global uint *moved_indices) {
    uint first = get_global_id(0) * chunk, end = min(n, first + chunk);
    uint at[MOST];
    for (uint d = 0; d < radix; ++d)
        at[d] = counts[get_global_id(0) * radix + d];
    move_chunk(given, first, end, shift, radix, last, at, moved, indices, moved_indices);
}

// All of a digit where there is one chunk.
__kernel void sort_digit(__global const WORD *given, uint n, uint shift, uint radix, uint last, __global WORD *moved,
                         __global const uint *indices, __global uint *moved_indices) {
    uint at[MOST], sum = 0;
    for (uint d = 0; d < radix; ++d)
        at[d] = 0;
    uint digit[BLOCK];
    for (uint i = 0; i < n; i += BLOCK) {
        uint count = digits(given, i, n, shift, radix, last, digit);
#pragma unroll 1
        for (uint k = 0; k < count; ++k)
            ++at[digit[k]];
    }
    for (uint d = 0; d < radix; ++d) {
        uint count = at[d];
        at[d] = sum;
        sum += count;
    }
    move_chunk(given, 0, n, shift, radix, last, at, moved, indices, moved_indices);
}
