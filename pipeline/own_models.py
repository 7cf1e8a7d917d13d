"""The gap of a model of one's own, from its files: composes record and diagnose; the command prints it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..__version__ import __version__
from ..diagnose.own.back import corrected_file, corrected_python
from ..diagnose.own.back_fmu import corrected_fmu
from ..diagnose.own.designs import designs_of
from ..diagnose.own.fmu import FmuModel
from ..diagnose.own.gap import OwnGap, own_gap
from ..diagnose.own.model import Model
from ..diagnose.own.read import named_model, read_model
from ..diagnose.own.records import read_records
from ..record.errors import EstimationError
from ..record.files import sha256_of_file, sha256_of_texts, write_text
from ..record.own_data import read_data_file
from ..record.results import write_result

Progress = Callable[[str, int, int | None], None]
ANSWERS = ("effect", "form_not_exact", "no_gap")
"""Verdicts that a corrected model follows from."""


def gap_of_model(
    model: str | Path | Model | FmuModel,
    tables: Sequence[Path],
    data: Path | None = None,
    held_out: Sequence[Path] = (),
    progress: Progress | None = None,
    tried: Sequence[Path] = (),
    law: bool = False,
) -> OwnGap:
    """Diagnose a model of one's own.

    Parameters
    ----------
    model : its file, or the model itself
    tables : records to fit
    data : what says what their columns are; None: NAME.toml or data.toml beside each
    held_out : records kept aside for the shrink; none: each in turn
    progress : is told what is done
    tried : tables of inputs that the next record may have, beside what [[next]] of data.toml spans
    law : a missing term of the states is searched, beside the library's effects

    Raises
    ------
    TowlineError : a file is wrong, or the model does not follow the records at all
    """
    inputs: dict[str, str] = {}
    if isinstance(model, str | Path):
        inputs[str(model)] = sha256_of_file(model)
        system = read_model(model)
    else:
        system = named_model(model, model.name)
    every = [Path(table) for table in (*tables, *held_out)]
    adapted, records = read_records(system, every, data)
    for table in every:
        inputs[str(table)] = _sha256(table)
        file = read_data_file(table, data)[0]
        inputs[str(file)] = sha256_of_file(file)
    for table in tried:
        inputs[str(table)] = sha256_of_file(table)
    designs = designs_of(adapted, records, every[0], tried, data)
    held = list(range(len(tables), len(every))) or None
    say = None if progress is None else lambda text: progress(text, 0, None)
    # the bootstrap of an interval: the same records give the same answer
    rng = np.random.default_rng(int.from_bytes("".join(sorted(inputs.values())).encode()[:8].ljust(8, b"0"), "big"))
    try:
        return own_gap(adapted, records, __version__, inputs, held, rng, say, designs=designs, law=law)
    except np.linalg.LinAlgError as error:
        raise EstimationError(f"the records' normal equations cannot be solved ({error}); do they move?") from error


def _sha256(table: Path) -> str:
    """Of a file, or of all files of a folder."""
    if not table.is_dir():
        return sha256_of_file(table)
    return sha256_of_texts(*(f"{p.name} {sha256_of_file(p)}" for p in sorted(table.iterdir()) if p.is_file()))


def write_gap(out: Path, found: OwnGap, model: Path) -> list[Path]:
    """Write gap.json, the corrected model as corrected.json and corrected.py where there is an answer, and next.csv, the inputs
    to record next, where they are none of the user's tables.

    Parameters
    ----------
    out : folder
    found : what was found
    model : the model's file

    Returns
    -------
    written : paths
    """
    written = [out / "gap.json"]
    write_result(written[0], found.file)
    if found.proposed is not None and found.proposed.columns:
        columns = found.proposed.columns
        rows = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True)]
        write_text(out / "next.csv", "\n".join([",".join(columns), *rows]) + "\n")
        written.append(out / "next.csv")
    if found.file.verdict in ANSWERS:
        path = out / "corrected.py"
        write_result(out / "corrected.json", corrected_file(found))
        write_text(path, corrected_python(found, model, path))
        written += [out / "corrected.json", path]
    return written


def write_fmu(out: Path, found: OwnGap, model: Path) -> list[Path]:
    """Write the corrected model as corrected.fmu where there is an answer.

    Parameters
    ----------
    out, found, model : as of ``write_gap``

    Returns
    -------
    written : paths

    Raises
    ------
    InputError : it cannot be an FMU (``back_fmu.check_wrappable``)
    """
    if found.file.verdict not in ANSWERS:
        return []
    corrected_fmu(found, model, out / "corrected.fmu")
    return [out / "corrected.fmu"]


__all__ = ["gap_of_model", "write_fmu", "write_gap"]
