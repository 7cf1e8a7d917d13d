"""docs/formats/reference.md, generated from the schemas: ``python -m towline.record.reference > docs/formats/reference.md``."""

from __future__ import annotations

import sys
import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from .budget_file import BudgetFile, BudgetInputs
from .cameras_file import CamerasFile
from .check_file import CheckFile
from .corrected_file import CorrectedFile
from .corrections import Corrections
from .day_file import DayFile
from .gap_file import GapFile
from .law_file import LawFile
from .lens_file import LensFile
from .own_data import OwnData
from .plan_file import PlanFile, PlanRequest
from .priors import Priors
from .results import CameraFile, DerivativesFile, SteadyFile, TruthFile
from .scenario import ScenarioFile
from .schema import RunFile
from .thorough_file import ThoroughFile
from .toml import described

_PAGES: tuple[tuple[str, type[BaseModel], str], ...] = (
    ("run.toml", RunFile, "The description of a run folder."),
    ("corrections.toml", Corrections, "What was set right by hand in the tracks of a run's video."),
    ("priors.toml", Priors, "The same keys as run.toml's [priors], as a file of their own (`--priors`)."),
    ("scenario.toml", ScenarioFile, "What `towline simulate` and `towline render` make."),
    ("out/camera.json", CameraFile, "Written by `towline motion`."),
    ("out/cameras.json", CamerasFile, "Written by `towline motion` of a run with two `[[camera]]`."),
    ("out/derivatives.json", DerivativesFile, "Written by `towline identify`."),
    ("out/budget.json", BudgetFile, "Written by `towline budget`."),
    ("inputs.toml", BudgetInputs, "What `towline budget --inputs` is told of its lines."),
    ("out/steady.json", SteadyFile, "Written by `towline steady`."),
    ("out/gap.json", GapFile, "Written by `towline diagnose` and, of a model of your own, by `towline gap`."),
    ("data.toml", OwnData, "What `towline gap` is told of the tables of a model of your own."),
    ("out/corrected.json", CorrectedFile, "Written by `towline gap`."),
    (
        "out/law.json",
        LawFile,
        "Written by `towline diagnose --law`, and where no effect of the library explains the gap.",
    ),
    ("out/thorough.json", ThoroughFile, "Written by `towline identify --thorough`."),
    ("out/check.json", CheckFile, "Written by `towline check`."),
    ("lens.json", LensFile, "Written by `towline lens`."),
    ("plan.toml", PlanRequest, "What `towline plan` is asked."),
    ("plan.json", PlanFile, "Written by `towline plan`."),
    ("day.json", DayFile, "Written by `towline live` after a tow, beside the day's tows."),
    ("truth/derivatives.json", TruthFile, "Written by `towline render`."),
)


def reference_page() -> str:
    """Return the reference page as Markdown."""
    lines = [
        "# Formats: every key",
        "",
        "Generated from the schemas in `record/`; do not edit. `python -m towline.record.reference` prints it.",
        "An unknown key is an error. Paths start at the folder of the file that names them.",
    ]
    for title, model, remark in _PAGES:
        lines += ["", f"## {title}", "", remark]
        lines += _tables(model, "", [])
    return "\n".join(lines) + "\n"


def _tables(model: type[BaseModel], prefix: str, seen: list[type[BaseModel]]) -> list[str]:
    lines = [
        "",
        f"### {prefix}" if prefix else "### (top)",
        "",
        "| key | type | default | meaning |",
        "|---|---|---|---|",
    ]
    inner: list[tuple[str, type[BaseModel]]] = []
    for name, field in model.model_fields.items():
        # the one key that is a table or an array of others
        key = (
            f"[[{field.validation_alias}]]"
            if isinstance(field.validation_alias, str) and not field.alias
            else field.alias or name
        )
        found = _model_in(field.annotation)
        if found is not None:
            inner.append((f"{prefix}.{key}" if prefix else key, found))
        lines.append(f"| `{key}` | {_type_name(field.annotation)} | {_default(field)} | {_escape(described(field))} |")
    for path, found in inner:
        if found not in seen:
            seen.append(found)
            lines += _tables(found, path, seen)
        else:
            lines += ["", f"### {path}", "", f"The keys of {found.__name__}, above."]
    return lines


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in get_args(annotation):
        found = _model_in(part)
        if found is not None:
            return found
    return None


def _type_name(annotation: Any) -> str:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _type_name(get_args(annotation)[0])
    if origin is Literal:
        return " / ".join(str(value) for value in get_args(annotation))
    if origin in (Union, types.UnionType):
        return _type_name(next(part for part in get_args(annotation) if part is not type(None)))
    if origin in (tuple, list):
        parts = get_args(annotation)
        if (len(parts) == 2 and parts[1] is Ellipsis) or origin is list:
            return f"array of {_type_name(parts[0])}"
        return "[" + ", ".join(_type_name(part) for part in parts) + "]"
    if origin is dict:
        return f"table of {_type_name(get_args(annotation)[1])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    names = {float: "number", str: "text", int: "integer", bool: "true/false"}
    return names.get(annotation, getattr(annotation, "__name__", str(annotation)))


def _escape(text: str) -> str:
    return text.replace("|", "\\|")


def _default(field: Any) -> str:
    if field.default is PydanticUndefined:
        return "" if field.default_factory is not None else "**needed**"
    if field.default is None or field.default == ():
        return "absent"
    if isinstance(field.default, tuple):
        return f"`{list(field.default)}`"
    if isinstance(field.default, bool):
        return f"`{str(field.default).lower()}`"
    return f"`{field.default!r}`".replace("'", '"')


if __name__ == "__main__":
    sys.stdout.write(reference_page())
