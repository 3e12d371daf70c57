"""Contracts of import-linter: no circle of files or folders; imports in functions and for the type checker count too.

`lint-imports` checks them with the others of pyproject.toml.
"""

from __future__ import annotations

from collections.abc import Iterable

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, output


class NoCircles(Contract):
    """No module imports itself, directly or through others."""

    type_name = "no_circles"

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Find the circles."""
        circles = circles_of(self.edges(graph))
        return ContractCheck(kept=not circles, metadata={"circles": circles})

    def edges(self, graph: ImportGraph) -> dict[str, set[str]]:
        """Return what each file imports."""
        return {m: graph.find_modules_directly_imported_by(m) for m in graph.modules}

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Print the circles."""
        for circle in check.metadata["circles"]:
            output.print_error(f"circle: {' -> '.join(circle)}")


class NoFolderCircles(NoCircles):
    """No folder imports itself through another: a folder is its own files, without those of the folders in it.

    The files at the top of a root package stand for themselves, since the layers of that package order them.
    """

    type_name = "no_folder_circles"

    def edges(self, graph: ImportGraph) -> dict[str, set[str]]:
        """Return what each folder imports."""
        edges: dict[str, set[str]] = {}
        for module in graph.modules:
            folder = folder_of(module, graph)
            others = {folder_of(m, graph) for m in graph.find_modules_directly_imported_by(module)} - {folder}
            edges.setdefault(folder, set()).update(others)
        return edges


def folder_of(module: str, graph: ImportGraph) -> str:
    """Return the folder of a file: a package for its `__init__` and the files beside it."""
    if graph.find_children(module):
        return module
    folder = module.rpartition(".")[0]
    return folder if "." in folder else module


def reached(edges: dict[str, set[str]], start: str) -> set[str]:
    """Return the modules that `start` imports, directly or through others, and itself."""
    found, ahead = {start}, [start]
    while ahead:
        for module in edges.get(ahead.pop(), ()):
            if module not in found:
                found.add(module)
                ahead.append(module)
    return found


def circles_of(edges: dict[str, set[str]]) -> list[list[str]]:
    """Return one short circle, with its first module at both ends, for each set of modules that import each other."""
    circles, covered = [], set()
    for start in sorted(edges):
        circle = None if start in covered else shortest(edges, edges[start], start)
        if circle:
            circles.append([start, *circle])
            covered |= {m for m in reached(edges, start) if start in reached(edges, m)}
    return circles


def shortest(edges: dict[str, set[str]], begin: Iterable[str], end: str) -> list[str] | None:
    """Return the shortest way from one of these modules to another; None without one."""
    ways = [[module] for module in sorted(begin)]
    seen = set(begin)
    for way in ways:
        if way[-1] == end:
            return way
        for module in sorted(edges.get(way[-1], set()) - seen):
            seen.add(module)
            ways.append([*way, module])
    return None
