// The tree over the nodes of all parts: a launch of its own, before which all parts are in memory.
__kernel void sh_join(MADE, uint parts, OUT) {
    sh_write(OUT_ARGS, sh_joined(MADE_ARGS, parts), 0, 1);
}
