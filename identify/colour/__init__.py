"""Coloured residuals: a hull that is pushed about, its Kalman filter, the choice between that and coloured measurement noise."""
