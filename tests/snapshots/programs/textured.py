import numpy as np

from shpy.backend.numpy.lanes import maximum, minimum, select, vector
from shpy.ir.meaning import convert, floor_mod_int, fract, mix


def sample_image(uv, image_mode, image):
    linear = image_mode & 1 != 0  # library.py:261
    repeat = image_mode & 2 != 0
    place = select(repeat, fract(uv), minimum(maximum(uv, -1.0), 2.0)) * vector(image.size[1].astype(np.float32), image.size[0].astype(np.float32))  # library.py:222
    shift = select(linear, np.float32(0.5), 0.0)  # library.py:229
    t = place - shift  # library.py:230
    corner = np.floor(t)
    t_2 = t - corner  # library.py:231
    t_3 = select(linear, t_2, 0.0)  # library.py:233
    cell = convert(corner, np.int32)  # library.py:234
    t4 = vector(select(repeat, floor_mod_int(cell[1], image.size[0]), cell[1]), select(repeat, floor_mod_int(cell[0], image.size[1]), cell[0]))  # library.py:264
    t5 = cell + np.int32([[1], [0]])  # library.py:239
    t6 = vector(select(repeat, floor_mod_int(t5[1], image.size[0]), t5[1]), select(repeat, floor_mod_int(t5[0], image.size[1]), t5[0]))  # library.py:264
    t7 = cell + np.int32([[0], [1]])  # library.py:239
    t8 = vector(select(repeat, floor_mod_int(t7[1], image.size[0]), t7[1]), select(repeat, floor_mod_int(t7[0], image.size[1]), t7[0]))  # library.py:264
    t9 = cell + 1  # library.py:239
    t10 = vector(select(repeat, floor_mod_int(t9[1], image.size[0]), t9[1]), select(repeat, floor_mod_int(t9[0], image.size[1]), t9[0]))  # library.py:264
    t11 = mix(mix(image.gather(t4), image.gather(t6), t_3[0]), mix(image.gather(t8), image.gather(t10), t_3[0]), t_3[1])  # library.py:241
    return t11  # library.py:264


def textured(uv, image_mode, image, lanes):
    return sample_image(uv * 2.0, image_mode, image)  # snapshot_programs.py:130
