"""New buffers of OpenCL: huge pages are asked for in the host's memory, and memory that is missing is an error."""

import mmap
import re
from pathlib import Path

import numpy as np
import pytest

from shpy.backend.opencl.device import buffers
from shpy.backend.opencl.device.buffers import new_buffer
from shpy.backend.opencl.device.driver import machine_of

SIZE = 1 << 23
BUSY = """
__kernel void busy(__global uint *out, uint turns) {
    uint x = out[0];
    for (uint i = 0; i < turns; ++i)
        x = x * 1664525u + (x >> 3);
    out[0] = x;
}
"""


@pytest.fixture
def machine():
    return machine_of(None)


def address_of(machine, buffer):
    flags = machine.cl.map_flags
    memory, _ = machine.cl.enqueue_map_buffer(machine.queue, buffer, flags.READ, 0, (buffer.size,), np.uint8)
    address = memory.__array_interface__["data"][0]
    memory.base.release(machine.queue)
    machine.queue.finish()
    return address


def flags_at(address):
    """Return the flags of the mapping at an address, as proc(5) names them."""
    within = False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        if mapping := re.match(r"([0-9a-f]+)-([0-9a-f]+) ", line):
            within = int(mapping[1], 16) <= address < int(mapping[2], 16)
        elif within and line.startswith("VmFlags:"):
            return line.split()[1:]
    raise ValueError("no mapping")


def test_huge_pages_are_asked_for(machine, monkeypatch):
    asked, madvise = [], buffers._madvise()
    monkeypatch.setattr(buffers, "_madvise", lambda: lambda *args: asked.append((*args, madvise(*args))))
    new_buffer(machine, SIZE // 4)
    buffer = new_buffer(machine, SIZE)
    if not (machine.shares_memory and hasattr(mmap, "MADV_HUGEPAGE")):
        assert asked == []
        return
    [(first, length, advice, result)] = asked
    address = address_of(machine, buffer)
    assert first % mmap.PAGESIZE == length % mmap.PAGESIZE == 0
    assert address <= first < address + mmap.PAGESIZE
    assert address + SIZE - mmap.PAGESIZE < first + length <= address + SIZE
    assert advice == mmap.MADV_HUGEPAGE
    # A kernel that was built without huge pages answers with an error.
    assert ("hg" in flags_at(first)) == (result == 0)
    assert (result == 0) == Path("/sys/kernel/mm/transparent_hugepage").exists()


def test_a_new_buffer_does_not_wait_for_the_queue(machine):
    kernel = machine.cl.Program(machine.context, BUSY).build().busy
    small = new_buffer(machine, 4)
    kernel.set_args(small, np.uint32(1 << 30))
    run = machine.cl.enqueue_nd_range_kernel(machine.queue, kernel, (1,), None)
    machine.queue.flush()
    new_buffer(machine, SIZE)
    assert run.command_execution_status != machine.cl.command_execution_status.COMPLETE
    run.wait()


def test_memory_that_the_host_lacks_is_an_error_of_the_driver(machine, monkeypatch):
    def refuse(size, dtype):
        raise MemoryError("Unable to allocate 8 TiB")

    monkeypatch.setattr(buffers.np, "empty", refuse)
    if not machine.shares_memory:
        new_buffer(machine, SIZE)
        return
    with pytest.raises(machine.cl.MemoryError, match="Unable to allocate 8 TiB"):
        new_buffer(machine, SIZE)
