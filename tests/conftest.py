"""Where things lie: the project, its sample videos, and the reference data that may stand beside the checkout."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"


@pytest.fixture(scope="session")
def root() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def samples(root: Path) -> Path:
    return root / "sample_videos"


@pytest.fixture(scope="session")
def shared() -> Path:
    if not SHARED.is_dir():
        pytest.skip("the reference data (../shared) does not stand beside this checkout")
    return SHARED


def _cases(root: Path, name: str) -> ModuleType:
    """A module of cases with their truth, the benchmarks' own."""
    spec = importlib.util.spec_from_file_location(name, root / "benchmarks" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def cameras(root: Path) -> ModuleType:
    """Random cameras and planted faults."""
    return _cases(root, "geometry_cases")


@pytest.fixture(scope="session")
def campaigns(root: Path) -> ModuleType:
    """Simulated tows."""
    return _cases(root, "identify_cases")


@pytest.fixture(scope="session")
def cases(root: Path) -> ModuleType:
    """Filmed campaigns with a planted effect."""
    return _cases(root, "gap_cases")
