"""Data flows one way: no import circle, deferred, for types or not; no room reaches back."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Each room may import from those before it.
ROOMS = [
    "mrsan",
    "samarl.files",
    "samarl.launch",
    "samarl.registry",
    "samarl.distributed",
    "samarl.observations",
    "samarl.planning",
    "samarl.runtime",
    "samarl.encoders",
    "samarl.policies",
    "samarl.rollout",
    "samarl.algorithms",
    "samarl.macro_level.network",
    "samarl.agents",
    "samarl.macro_level",
    "samarl.export",
    "samarl.physics",
    "samarl.evaluation",
    "samarl.prediction",
    "samarl.user_files",
    "samarl.configuration",
    "samarl.submission",
    "samarl.training",
    "samarl.report",
    "samarl.api",
    "samarl.play",
    "samarl.run",
    "samarl.commands",
]


def modules() -> dict[str, Path]:
    paths = {}
    for base, folder in (("samarl", ROOT / "samarl"), ("mrsan", ROOT / "envs/mrsan")):
        for path in folder.rglob("*.py"):
            parts = [base, *path.relative_to(folder).with_suffix("").parts]
            paths[".".join(parts).removesuffix(".__init__")] = path
    return paths


def imports() -> dict[str, set[str]]:
    """What each module imports, at its top, inside its functions or for types alone."""
    known = modules()
    dependencies: dict[str, set[str]] = {}
    for name, path in known.items():
        targets: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                whole = [f"{node.module}.{alias.name}" for alias in node.names]
                targets |= {target if target in known else node.module for target in whole}
            elif isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names}
        dependencies[name] = targets & set(known) - {name}
    return dependencies


def test_there_is_no_import_circle() -> None:
    graph, done = imports(), set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join([*path[path.index(name) :], name])
        if name not in done:
            for target in sorted(graph[name]):
                visit(target, (*path, name))
            done.add(name)

    for name in sorted(graph):
        visit(name, ())


def room(name: str) -> int | None:
    of = [i for i, prefix in enumerate(ROOMS) if f"{name}.".startswith(f"{prefix}.")]
    return of[0] if of else None


def test_no_room_reaches_back() -> None:
    wrong = [
        f"{name} imports {target}"
        for name, targets in imports().items()
        for target in targets
        if (here := room(name)) is not None and (there := room(target)) is not None and there > here
    ]
    assert wrong == []
