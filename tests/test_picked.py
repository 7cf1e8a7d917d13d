"""Points digitised by hand in a few frames, and what is filled in between them where asked."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from towline.record import EstimationError
from towline.vision.picked import interpolated

RATE_HZ, EVERY, SIGMA_PX = 30.0, 15, 0.5


def path(t_s: np.ndarray) -> np.ndarray:
    """A bow swinging with 6 s."""
    return 400 + 60 * np.sin(2 * np.pi * t_s / 6.0)


def clicks(seed: int, sigma: float | None = SIGMA_PX) -> pd.DataFrame:
    frame = np.arange(0, 600, EVERY)
    t_s = frame / RATE_HZ
    noise = np.random.default_rng(seed).normal(0, SIGMA_PX, (2, len(t_s)))
    table = pd.DataFrame(
        {"frame": frame, "t_s": t_s, "marker": "bow", "u_px": path(t_s) + noise[0], "v_px": 200 + noise[1]}
    )
    table["sigma_u_px"] = table["sigma_v_px"] = np.nan if sigma is None else sigma
    table["status"] = "measured"
    return table


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [SIGMA_PX, None])
def test_what_is_filled_in_is_as_uncertain_as_it_says(sigma: float | None) -> None:
    """40 recordings; errors within one hang together, so a standard deviation is known to some 3 %."""
    z = []
    for seed in range(40):
        filled = interpolated(clicks(seed, sigma), RATE_HZ, 1.0)
        new = filled[filled["status"] == "predicted"]
        z.append(((new["u_px"] - path(new["t_s"].to_numpy())) / new["sigma_u_px"]).to_numpy())
        z.append(((new["v_px"] - 200) / new["sigma_v_px"]).to_numpy())
    assert 0.85 < np.concatenate(z).std() < 1.1


def test_digitised_rows_stay_and_wide_gaps_stay_empty() -> None:
    given = clicks(1)
    given = given[~given["t_s"].between(8.0, 10.0)].reset_index(drop=True)
    filled = interpolated(given, RATE_HZ, 1.0)
    kept = filled[filled["status"] == "measured"].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, given, check_dtype=False)
    gap = filled[filled["t_s"].between(7.9, 10.1) & (filled["status"] != "measured")]
    assert (gap["status"] == "lost").all()
    assert gap[["u_px", "v_px"]].isna().all().all()
    assert len(filled) == 586
    assert filled["t_s"].is_monotonic_increasing
    np.testing.assert_allclose(filled["frame"], np.rint(filled["t_s"] * RATE_HZ))


def test_too_few_points_are_refused() -> None:
    with pytest.raises(EstimationError, match=r"'bow': 4 digitised points"):
        interpolated(clicks(1).head(4), RATE_HZ, 1.0)
    with pytest.raises(EstimationError, match="must be positive"):
        interpolated(clicks(1), 0.0, 1.0)
