import numpy as np

from shpy.backends.numpy.lanes import maximum, minimum, select, vector
from shpy.ir.meaning import convert, floor_mod_int, fract, mix


def sample_image(uv, image_mode, image):
    size = vector(image.size[1].astype(np.float32), image.size[0].astype(np.float32))  # library.py:187
    t = image_mode & 2 != 0  # library.py:185
    inside = select(t, fract(uv), minimum(maximum(uv, -1.0), 2.0))  # library.py:194
    place = inside * size  # library.py:196
    t2 = image_mode & 1 != 0  # library.py:185
    shift = select(t2, np.float32(0.5), 0.0)  # library.py:205
    t3 = place - shift  # library.py:206
    corner = np.floor(t3)
    t_4 = t3 - corner  # library.py:207
    t_5 = select(t2, t_4, 0.0)  # library.py:209
    cell = convert(corner, np.int32)  # library.py:210
    t6 = vector(select(t, floor_mod_int(cell[1], image.size[0]), cell[1]), select(t, floor_mod_int(cell[0], image.size[1]), cell[0]))  # library.py:201
    t7 = cell + np.int32([[1], [0]])  # library.py:211
    t8 = vector(select(t, floor_mod_int(t7[1], image.size[0]), t7[1]), select(t, floor_mod_int(t7[0], image.size[1]), t7[0]))  # library.py:201
    top = mix(image.gather(t6), image.gather(t8), t_5[0])  # library.py:211
    t9 = cell + np.int32([[0], [1]])  # library.py:212
    t10 = vector(select(t, floor_mod_int(t9[1], image.size[0]), t9[1]), select(t, floor_mod_int(t9[0], image.size[1]), t9[0]))  # library.py:201
    t11 = cell + 1  # library.py:212
    t12 = vector(select(t, floor_mod_int(t11[1], image.size[0]), t11[1]), select(t, floor_mod_int(t11[0], image.size[1]), t11[0]))  # library.py:201
    bottom = mix(image.gather(t10), image.gather(t12), t_5[0])  # library.py:212
    return mix(top, bottom, t_5[1])  # library.py:213


def textured(uv, image_mode, image, lanes):
    return sample_image(uv * 2.0, image_mode, image)  # snapshot_programs.py:130
