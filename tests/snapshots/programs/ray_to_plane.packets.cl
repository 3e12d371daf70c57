void ray_to_plane_packet(  // snapshot_programs.py:148
    float8x3 ray_o,
    float8x3 ray_d,
    float8 height,
    float8 *o_x,
    float8 *o_y,
    float8 *o_z,
    float8 *d_x,
    float8 *d_y,
    float8 *d_z,
    int8 *status,
    int2 corner,
    ulong count,
    int row) {
    *o_x = (float8)(0.0f);
    *o_y = (float8)(0.0f);
    *o_z = (float8)(0.0f);
    *d_x = (float8)(0.0f);
    *d_y = (float8)(0.0f);
    *d_z = (float8)(0.0f);
    sh_packet packet = sh_packet_at(corner, count, row);
    int8 active = packet.active;
    int8 running = active;
    *status = (int8)(1);
    float8 t = (height - ray_o.y) / ray_d.y;  // snapshot_programs.py:150
    int8 leaving = active & (t < 0.0f);
    if (sh_any(leaving)) {
        *status = leaving ? (int8)(0) : *status;  // snapshot_programs.py:151
        running &= ~leaving;
    }
    if (!sh_any(running)) {
        return;
    }
    float8 o_x_2 = ray_o.x + t * ray_d.x;  // snapshot_programs.py:152
    float8 o_y_2 = ray_o.y + t * ray_d.y;
    float8 o_z_2 = ray_o.z + t * ray_d.z;
    float8 d_x_2 = -ray_d.x;
    float8 d_y_2 = -ray_d.y;
    float8 d_z_2 = -ray_d.z;
    *o_x = o_x_2;
    *o_y = o_y_2;
    *o_z = o_z_2;
    *d_x = d_x_2;
    *d_y = d_y_2;
    *d_z = d_z_2;
}

__kernel void ray_to_plane(  // snapshot_programs.py:148
    ulong count,
    int first,
    int row,
    __global const float *ray_o_in,
    int ray_o_step,
    __global const float *ray_d_in,
    int ray_d_step,
    __global const float *height_in,
    int height_step,
    __global float *o_out,
    __global float *d_out,
    __global int *status_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8x3 ray_o = sh_read_f3(ray_o_in, ray_o_step, packet);
    float8x3 ray_d = sh_read_f3(ray_d_in, ray_d_step, packet);
    float8 height = sh_read_f(height_in, height_step, packet);
    float8 o_x;
    float8 o_y;
    float8 o_z;
    float8 d_x;
    float8 d_y;
    float8 d_z;
    int8 status;
    ray_to_plane_packet(ray_o, ray_d, height, &o_x, &o_y, &o_z, &d_x, &d_y, &d_z, &status, corner, count, row);
    sh_write_f3(o_out, (float8x3){o_x, o_y, o_z}, packet);
    sh_write_f3(d_out, (float8x3){d_x, d_y, d_z}, packet);
    sh_write_i(status_out, status, packet);
}
