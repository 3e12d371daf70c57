__kernel void tally(__global const int *numbers, uint n, uint chunk, uint bins, __global int *counts) {
    uint first = get_global_id(0) * chunk, end = min(n, first + chunk);
    __global int *own = counts + (size_t)get_global_id(0) * bins;
    for (uint b = 0; b < bins; ++b)
        own[b] = 0;
    for (uint i = first; i < end; ++i)
        if ((uint)numbers[i] < bins)
            ++own[numbers[i]];
}

__kernel void add_tallies(__global int *counts, uint bins, uint chunks) {
    uint b = get_global_id(0);
    if (b < bins)
        for (uint c = 1; c < chunks; ++c)
            counts[b] += counts[(size_t)c * bins + b];
}
