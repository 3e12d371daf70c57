__attribute__((always_inline)) float8x3 sample_image(  // library.py:254
    float8x2 uv,
    __global const float4 *image,
    int2 image_size,
    int image_mode) {
    bool linear = (image_mode & 1) != 0;  // library.py:261
    bool repeat = (image_mode & 2) != 0;
    int t = image_size.x;  // library.py:263
    int t2 = image_size.y;
    float8 place_x = ((int8)(-repeat) ? uv.x - floor(uv.x) : sh_min8(sh_max8(uv.x, (float8)(-1.0f)), (float8)(2.0f))) * (float)t2;  // library.py:222
    float8 place_y = ((int8)(-repeat) ? uv.y - floor(uv.y) : sh_min8(sh_max8(uv.y, (float8)(-1.0f)), (float8)(2.0f))) * (float)t;
    float shift = linear ? 0.5f : 0.0f;  // library.py:229
    float8 t3 = place_x - shift;  // library.py:230
    float8 t4 = place_y - shift;
    float8 corner_x = floor(t3);
    float8 corner_y = floor(t4);
    float8 t_x = t3 - corner_x;  // library.py:231
    float8 t_y = t4 - corner_y;
    float8 t_x_2 = (int8)(-linear) ? t_x : (float8)(0.0f);  // library.py:233
    float8 t_y_2 = (int8)(-linear) ? t_y : (float8)(0.0f);
    int8 cell_x = convert_int8_sat(corner_x);  // library.py:234
    int8 cell_y = convert_int8_sat(corner_y);
    int8 t5 = (int8)(-repeat) ? sh_floormod_i8(cell_y, (int8)(t)) : cell_y;  // library.py:194
    int8 t6 = (int8)(-repeat) ? sh_floormod_i8(cell_x, (int8)(t2)) : cell_x;
    int8 t7 = as_int8(as_uint8(cell_x) + (uint)1);  // library.py:239
    int8 t8 = (int8)(-repeat) ? sh_floormod_i8(t7, (int8)(t2)) : t7;  // library.py:194
    float8x3 t9 = mix3(sh_gather_f3(image, sh_at2_lanes((int8x2){t5, t6}, image_size)), sh_gather_f3(image, sh_at2_lanes((int8x2){t5, t8}, image_size)), (float8x3){t_x_2, t_x_2, t_x_2});  // library.py:241
    int8 t10 = as_int8(as_uint8(cell_y) + (uint)1);  // library.py:239
    int8 t11 = (int8)(-repeat) ? sh_floormod_i8(t10, (int8)(t)) : t10;  // library.py:194
    float8x3 t12 = mix3(sh_gather_f3(image, sh_at2_lanes((int8x2){t11, t6}, image_size)), sh_gather_f3(image, sh_at2_lanes((int8x2){t11, t8}, image_size)), (float8x3){t_x_2, t_x_2, t_x_2});  // library.py:241
    return mix3(t9, t12, (float8x3){t_y_2, t_y_2, t_y_2});
}

__kernel void textured(  // snapshot_programs.py:128
    ulong count,
    int first,
    int row,
    __global const float *uv_in,
    int uv_step,
    __global const float4 *image,
    int2 image_size,
    int image_mode,
    __global float *result_out) {
    int2 corner = sh_corner(first, row);
    sh_packet packet = sh_packet_at(corner, count, row);
    if (packet.empty) {
        return;
    }
    float8x2 uv = sh_read_f2(uv_in, uv_step, packet);
    float8x3 t = sample_image((float8x2){uv.x * 2.0f, uv.y * 2.0f}, image, image_size, image_mode);  // snapshot_programs.py:130
    float8 result_x = t.x;
    float8 result_y = t.y;
    float8 result_z = t.z;
    sh_write_f3(result_out, (float8x3){result_x, result_y, result_z}, packet);
}
