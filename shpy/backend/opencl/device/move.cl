// Element i of `from` becomes element j of `to`. Loops over the components take up to 1.7 times as long.
#if SIZE == 1
#define MOVE(from, i, to, j) to[j] = from[i]
#else
#define MOVE(from, i, to, j) vstoreSIZE(vloadSIZE(i, from), j, to)
#endif

__kernel void forget(__global int *winners, uint n) {
    if (get_global_id(0) < n)
        winners[get_global_id(0)] = -1;
}

// The last element of each place wins, in whatever order the device runs them.
__kernel void compete(__global const INDEX *indices, uint n, uint places, __global volatile int *winners) {
    size_t i = get_global_id(0);
    if (i < n && (uint)indices[i] < places)
        atomic_max(winners + indices[i], (int)i);
}

__kernel void put(__global const WORD *values, __global const int *winners, uint n, __global WORD *target) {
    size_t i = get_global_id(0);
    if (i < n && winners[i] >= 0)
        MOVE(values, (size_t)winners[i], target, i);
}

// No place occurs twice.
__kernel void place(__global const WORD *values, __global const INDEX *indices, uint n, __global WORD *target) {
    size_t i = get_global_id(0);
    if (i < n)
        MOVE(values, i, target, (size_t)indices[i]);
}
