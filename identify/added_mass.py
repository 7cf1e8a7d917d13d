"""Y_vdot and N_rdot alone, from m - Y_vdot and I - N_rdot with the dry model's mass and inertia (7.7.1, 8.2.4)."""

from __future__ import annotations

import math

from ..record.results import Derivative, Measured
from ..record.schema import ModelTable


def dry_mass(model: ModelTable) -> Measured:
    """m of the ballasted model as weighed, kg; the displacement mass where it was not."""
    value = model.mass_kg if model.dry_mass_kg is None else model.dry_mass_kg
    return Measured(value=value, std=model.dry_mass_sd_kg)


def dry_inertia(model: ModelTable) -> Measured | None:
    """I about the LCG, kg m2: as swung, or K^2 m of the ballast's places (8.9b); None where neither is given."""
    if model.yaw_inertia_kg_m2 is not None:
        return Measured(value=model.yaw_inertia_kg_m2, std=model.yaw_inertia_sd_kg_m2)
    if model.gyration_k2_m2 is None:
        return None
    mass = dry_mass(model)
    std = math.hypot(mass.value * model.gyration_k2_sd_m2, model.gyration_k2_m2 * mass.std)
    return Measured(value=model.gyration_k2_m2 * mass.value, std=std)


def added_masses(model: ModelTable, derivatives: dict[str, Derivative]) -> tuple[Measured | None, Measured | None]:
    """Y_vdot = m - (m - Y_vdot), kg, and N_rdot = I - (I - N_rdot), kg m2.

    Parameters
    ----------
    model : with ``dry_mass_kg`` for the first, ``yaw_inertia_kg_m2`` or ``gyration_k2_m2`` for the second
    derivatives : by name, with m_minus_y_vdot and i_minus_n_rdot where the runs fix them

    Returns
    -------
    Y_vdot, N_rdot : None where the dry value or the derivative is missing; the scale and the derivatives are measured apart, so
        their variances add

    >>> model = ModelTable(length_pp_m=2.66, mass_kg=78.0, dry_mass_kg=78.0, dry_mass_sd_kg=0.1)
    >>> found = {"m_minus_y_vdot": Derivative(value=149.2, std=0.3, unit="kg", prime=0.0155, prime_std=3e-5)}
    >>> y_vdot, n_rdot = added_masses(model, found)
    >>> round(y_vdot.value, 3), round(y_vdot.std, 3), n_rdot
    (-71.2, 0.316, None)
    """
    mass = None if model.dry_mass_kg is None else dry_mass(model)
    return _less(mass, derivatives.get("m_minus_y_vdot")), _less(dry_inertia(model), derivatives.get("i_minus_n_rdot"))


def _less(dry: Measured | None, whole: Derivative | None) -> Measured | None:
    if dry is None or whole is None:
        return None
    return Measured(value=dry.value - whole.value, std=math.hypot(dry.std, whole.std))
