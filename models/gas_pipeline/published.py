"""Published results of Shaheen 2024 for its pipeline, in SI: Tables IV to VII.

Sources name the table and no page: the text from which the numbers were taken has no pages. Its Fig. 5 to 7 (ROC
curves, isolation matrices, RMSE under faults) have no numbers.
"""

from __future__ import annotations

from fusion_sfdia.report.results import Published

QUANTITIES = ("pressure", "mass flow", "temperature")
FAULTS = ("strong-bias", "weak-bias", "strong-drift", "weak-drift")
FILTERS = ("fusing-enkf", "fusing-ukf", "fusing-ekf", "enkf", "ukf", "ekf")

_TABLE_IV = {  # RMSE in 1e-3 MPa, kg/s, K
    "high": (
        (0.13547, 0.7441, 0.3500), (0.082194, 0.4172, 0.2120), (1.0727, 0.5445, 0.1009),
        (0.3829, 1.2886, 0.6622), (0.070686, 0.1689, 0.2329), (1.4684, 0.7488, 0.2009),
    ),
    "moderate": (
        (0.219, 1.0672, 0.5879), (0.12307, 0.6463, 0.3472), (3.4249, 0.8852, 0.3427),
        (0.44852, 0.8669, 0.3051), (0.15820, 0.8022, 0.4490), (2.6018, 0.8695, 0.3328),
    ),
    "low": (
        (0.4031, 2.3451, 1.4395), (0.33872, 1.9596, 1.0892), (0.93483, 0.6716, 0.1176),
        (0.43635, 1.8683, 1.8683), (0.449303, 2.6353, 1.5484), (7.1529, 2.0372, 1.1611),
    ),
}  # fmt: skip

# per quantity, rows fusing EnKF, UKF, EKF; columns strong and weak bias, strong and weak drift; per cent
_ACCURACY = {
    "low": ("Table V", (
        ((86.11, 86.11, 83.33, 72.22), (100, 97.22, 100, 100), (45.00, 41.67, 46.67, 41.67)),
        ((77.78, 72.22, 88.89, 86.11), (100, 100, 86.11, 63.89), (88.33, 95, 91.67, 83.33)),
        ((86.11, 86.11, 83.33, 77.78), (100, 100, 88.89, 86.11), (100, 100, 83.33, 76.67)),
    )),
    "moderate": ("Table VI", (
        ((89.44, 88.89, 87.78, 87.50), (100, 100, 100, 100), (46.67, 45.00, 61.67, 58.89)),
        ((88.61, 83.89, 79.72, 67.78), (100, 100, 94.17, 83.89), (100, 97.78, 90.28, 92.22)),
        ((91.76, 88.25, 81.11, 62.78), (97.22, 97.92, 94.44, 90.83), (100, 100, 97.50, 93.61)),
    )),
    "high": ("Table VII", (
        ((100, 100, 86.11, 80.56), (100, 97.22, 100, 91.67), (69.44, 69.44, 69.44, 69.44)),
        ((100, 100, 94.44, 88.89), (100, 97.22, 86.11, 66.67), (100, 100, 91.67, 88.89)),
        ((91.67, 94.44, 100, 100), (97.22, 97.22, 91.67, 69.44), (100, 100, 100, 77)),
    )),
}  # fmt: skip


def rmse(snr: str, filter_name: str, quantity: str) -> Published | None:
    """Table IV: RMSE of a filter ("fusing-ekf", "ekf", ...) in Pa, kg/s or K; None for filters that it does not list."""
    if filter_name not in FILTERS:
        return None
    i = QUANTITIES.index(quantity)
    value = _TABLE_IV[snr][FILTERS.index(filter_name)][i]
    return Published(round(value * 1e3, 6) if i == 0 else value, f"Shaheen 2024, Table IV, {snr} SNR")


def accuracy(snr: str, filter_name: str, quantity: str, fault: str) -> Published | None:
    """Tables V to VII: detection accuracy as a fraction; None for filters that they do not list."""
    if filter_name not in FILTERS[:3]:
        return None
    table, values = _ACCURACY[snr]
    value = values[QUANTITIES.index(quantity)][FILTERS.index(filter_name)][FAULTS.index(fault)]
    return Published(round(value / 100, 6), f"Shaheen 2024, {table}")
