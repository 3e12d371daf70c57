"""Backends with a fault on purpose: a module is changed before it is compiled.

with_fault(monkeypatch, "numpy", op("floor", "ceil"))        # numpy rounds up from now on
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from shpy.backend.registry import backend
from shpy.ir.nodes import Function, Let, Module
from shpy.ir.traverse import rewrite
from shpy.run import kernel as kernels


def with_fault(monkeypatch: Any, name: str, fault: Callable[[Module], Module]) -> None:
    backend(name).devices()  # which ask the driver, by modules of their own
    found = type(backend(name))
    right = found.compile
    monkeypatch.setattr(kernels, "_executables", {})
    monkeypatch.setattr(found, "compile", lambda self, module, *rest: right(self, fault(module), *rest))


def op(old: str, new: str) -> Callable[[Module], Module]:
    """Every operation `old` is done as `new`."""

    def changed(statement: Any) -> Any:
        if isinstance(statement, Let) and statement.op == old:
            return replace(statement, op=new)
        return statement

    def fault(module: Module) -> Module:
        def function(f: Function) -> Function:
            return replace(f, body=rewrite(f.body, changed))

        return replace(module, functions=tuple(map(function, module.functions)))

    return fault
