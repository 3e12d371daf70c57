"""Generated programs at length, undisturbed and in the stress mode; the default suite's do the same in property."""

import pytest
from property.test_generated import agree

OPENCL = ("opencl-1", "opencl-4", "opencl-8", "opencl-16")


@pytest.mark.slow
@pytest.mark.parametrize("part", range(2))
@pytest.mark.parametrize("shard", range(5000, 5113))
def test_many_programs_agree_in_the_stress_mode(shard, part):
    agree(shard, part, ("numpy", OPENCL[shard % 4], "glsl"), endless=shard % 3 == 0)
