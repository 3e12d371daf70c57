"""A contract of import-linter: no circle of files, where imports in functions and for the type checker count too.

`lint-imports` checks it with the others of pyproject.toml. An import that is ignored must be part of a circle.
"""

from __future__ import annotations

from collections.abc import Iterable

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output

Import = tuple[str, str]


class NoCircles(Contract):
    """No module imports itself, directly or through others.

    Options:

        - ignore_imports: imports that are to be removed, as "importer -> imported".
    """

    type_name = "no_circles"

    ignore_imports = fields.SetField(subfield=fields.StringField(), required=False)

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Find the circles that are left without the ignored imports, and the ignored imports that close none."""
        ignored: set[Import] = {tuple(entry.split(" -> ")) for entry in self.ignore_imports or ()}  # type: ignore[misc]
        edges = {m: graph.find_modules_directly_imported_by(m) for m in graph.modules}
        kept = {m: {n for n in found if (m, n) not in ignored} for m, found in edges.items()}
        circles = circles_of(kept)
        unneeded = [
            (importer, imported)
            for importer, imported in sorted(ignored)
            if imported not in edges.get(importer, ()) or importer not in reached(kept, imported)
        ]
        metadata = {"circles": circles, "unneeded": unneeded}
        return ContractCheck(kept=not circles and not unneeded, metadata=metadata)

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Print the circles and the entries without need."""
        for circle in check.metadata["circles"]:
            output.print_error(f"circle: {' -> '.join(circle)}")
        for importer, imported in check.metadata["unneeded"]:
            output.print_error(f"closes no circle, remove the entry: {importer} -> {imported}")


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
