"""The site's part of ``mkdocs build``: files beside docs/, the page of the API, and GitHub's Markdown made Python-Markdown's."""

from __future__ import annotations

import importlib.util
import posixpath
import re
from pathlib import Path
from typing import Any

DOCS, APP = "docs", "app.md"
README = {"README.md": "readme.md"}  # docs/ has an index of its own
ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(\]\()([^)\s#:]+)((?:#[^)\s]*)?(?:\s[^)]*)?\))")
FENCE = re.compile(r"^(\s*)(`{3,})(\w*)(.*)$")
ITEM = re.compile(r"^\s*(?:[-*]|\d+\.)\s")


def on_startup(**_: Any) -> None:
    """mkdocstrings reads the rooms alone: where their folder is not there before the configuration, all of the checkout."""
    _api(ROOT).sources(ROOT)


def on_config(config: Any) -> Any:
    """The web page's own page comes into the navigation as soon as it is there."""
    if (Path(config["docs_dir"]) / APP).is_file() and APP not in str(config["nav"]):
        use = next(part["Use"] for part in config["nav"] if "Use" in part)
        use.insert(1, {"The app": APP})
    return config


def on_files(files: Any, config: Any) -> Any:
    """Take in what the pages link to outside docs/ (benchmarks, examples, sample recordings), and write the API's pages."""
    from mkdocs.structure.files import File

    root = Path(config["docs_dir"]).parent
    pages = [file for file in files if file.is_documentation_page()]
    while pages:
        page = pages.pop()
        for target in outside(page.content_string, page.src_uri):
            place = root / target
            if files.get_file_from_path(README.get(target, target)) is None and place.is_file():
                file = File.generated(config, README.get(target, target), abs_src_path=str(place))
                files.append(file)
                if file.is_documentation_page():
                    pages.append(file)
    for name, content in _api(root).pages().items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """The page as Python-Markdown understands it."""
    return for_python_markdown(with_inner_links(markdown, page.file.src_uri))


def outside(markdown: str, page: str) -> list[str]:
    """Targets of the page's links that lie beside docs/, as paths from the root."""
    found = []
    for link in LINK.finditer(markdown):
        target = posixpath.normpath(posixpath.join(_folder(page), link[2]))
        if not target.startswith((DOCS + "/", "..")):
            found.append(target)
    return found


def with_inner_links(markdown: str, page: str) -> str:
    """Links to files beside docs/ led to their copies, which stand in the site as if docs/ were the root."""

    def led(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(_folder(page), link[2]))
        if (ROOT / target / "README.md").is_file():
            target = posixpath.join(target, "README.md")
        target = README.get(target, target).removeprefix(DOCS + "/")
        inner = posixpath.relpath(target, posixpath.dirname(page) or ".")
        return f"{link[1]}{inner}{link[3]}"

    return LINK.sub(led, markdown)


def _folder(page: str) -> str:
    """The folder of a page, from the root: pages of docs/ have lost it, files from beside docs/ have kept theirs."""
    inside = page not in README.values() and not page.startswith(
        ("sample_videos/", "benchmarks/", "examples/", "tests/")
    )
    return posixpath.join(DOCS if inside else "", posixpath.dirname(page))


def for_python_markdown(markdown: str) -> str:
    """Markers of the docs' test taken off the fences; a blank line before each list, which GitHub does not need."""
    lines: list[str] = []
    fence: str | None = None
    listed = False
    for line in markdown.split("\n"):
        mark = FENCE.match(line)
        if mark and (fence is None or mark[2] == fence):
            line = f"{mark[1]}{mark[2]}{mark[3]}" if fence is None else line
            fence = mark[2] if fence is None else None
        elif fence is None:
            if ITEM.match(line) and lines and lines[-1].strip() and not listed:
                lines.append("")
            listed = bool(ITEM.match(line)) or (listed and bool(line.strip()))
        lines.append(line)
    return "\n".join(lines)


def _api(root: Path) -> Any:
    """The module beside this one (hooks are no package)."""
    spec = importlib.util.spec_from_file_location("towline_docs_api", root / DOCS / "site" / "api.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
