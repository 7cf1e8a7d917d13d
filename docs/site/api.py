"""The pages of the Python interface: which names stand on which page; mkdocstrings makes the rest of their docstrings."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

FRONT = "towline.pipeline.front"
PAGES = {
    "record": ("towline.record", "towline.record.imported", "towline.record.exports"),
    "simulate": ("towline.simulate",),
    "geometry": ("towline.geometry", "towline.geometry.checks"),
    "vision": ("towline.vision",),
    "identify": ("towline.identify", "towline.identify.methods"),
    "diagnose": ("towline.diagnose", "towline.diagnose.effects", "towline.diagnose.users"),
    "report": ("towline.report",),
}
"""Page -> modules whose ``__all__`` stands on it."""
HEAD = """# The front door

What a user calls, one function a step: `import towline`, then `towline.track(...)`. Arrays are numpy's, tables pandas',
times s, places m, angles rad unless a name says otherwise. What raises says so; errors are `towline.record`'s, all of
them `TowlineError`. The rooms behind the door, for who builds on them: {rooms}.
"""


def pages() -> dict[str, str]:
    """Address of a page -> its Markdown."""
    made = {f"api/{name}.md": room_page(name, rooms) for name, rooms in PAGES.items()}
    rooms = ", ".join(f"[{name}](api/{name}.md)" for name in PAGES)
    door = importlib.import_module(FRONT)
    named = [entry("towline", name, f"{FRONT}.{name}") for name in public(door, in_order=True)]
    return {"api.md": "\n".join([HEAD.format(rooms=rooms), *named])} | made


def room_page(name: str, rooms: tuple[str, ...]) -> str:
    """All public names of some modules."""
    parts = [f"# {name}\n"]
    for room in rooms:
        module = importlib.import_module(room)
        first = (inspect.getdoc(module) or "").split("\n\n")[0].replace("\n", " ")
        parts.append(f"## {room}\n\n{first}\n")
        parts += [entry(room, each, home(module, each), getattr(module, each)) for each in public(module)]
    return "\n".join(parts)


def public(module: ModuleType, in_order: bool = False) -> list[str]:
    """Names of ``__all__``; without one, classes and functions that the module itself defines."""
    named = getattr(module, "__all__", None)
    if named is None:
        named = [
            n for n, v in vars(module).items() if getattr(v, "__module__", None) == module.__name__ and n[0] != "_"
        ]
    return list(named) if in_order else sorted(named, key=str.lower)


def home(module: ModuleType, name: str) -> str:
    """Where a name is defined, which is where its source is read."""
    return f"{getattr(getattr(module, name), '__module__', '')}.{name}"


def entry(room: str, name: str, place: str, thing: object = None) -> str:
    """One name, reached by its room's address too."""
    anchor = f'<a id="{room}.{name}"></a>\n'
    if thing is not None and not isinstance(thing, type | Callable):
        return f"{anchor}\n### {name}\n\nA constant: `{thing!r}`.\n"
    members = "\n    options: {members: false}" if hasattr(thing, "model_fields") else ""  # every key has a page
    return f"{anchor}\n::: {place}{members}\n"


def sources(root: Path) -> Path:
    """A folder with the package's rooms and nothing else of the checkout, for mkdocstrings to read."""
    package = root / "build" / "api" / "towline"
    package.mkdir(parents=True, exist_ok=True)
    for place in (root / "__init__.py", *(path.parent for path in root.glob("*/__init__.py"))):
        link = package / place.name
        if not link.exists():
            link.symlink_to(place, target_is_directory=place.is_dir())
    return package.parent
