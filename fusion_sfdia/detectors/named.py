"""The named detectors: a description of each, what builds it for a plant, and its memory.

A description states the method, its tests and how it isolates, with the source in brackets.
"""

from __future__ import annotations

from fusion_sfdia.detectors.registry import register_detector

FALSE_ALARM = 1e-3  # per step over all sensors, for every detector here
CHEBYSHEV_ALPHA = 5.0  # false alarms of a residual: at most 1/25 of all steps, with Gaussian noise 6e-7

NONE = "none"
STATE = "state estimate only"

register_detector(
    "fusing-ekf",
    "bank of extended Kalman filters, each without one sensor, fused by an information mixture; tests the variance "
    "of their estimates and isolates the sensor whose filter is farthest from the mixture (Shaheen 2024)",
    "fusion_sfdia.learning.builders:printed_bank",
    memory=STATE,
    most_faults=1,
    learns=True,
    kind="ekf",
)
register_detector(
    "fusing-ukf",
    "fusing-ekf with unscented Kalman filters that reuse the propagated sigma points, as printed (Shaheen 2024)",
    "fusion_sfdia.learning.builders:printed_bank",
    memory=STATE,
    most_faults=1,
    learns=True,
    kind="ukf",
)
register_detector(
    "fusing-enkf",
    "fusing-ekf with ensemble Kalman filters of 40 members (Shaheen 2024)",
    "fusion_sfdia.learning.builders:printed_bank",
    memory=STATE,
    most_faults=1,
    learns=True,
    kind="enkf",
)
register_detector(
    "filterpy-ekf",
    "fusing-ekf with the extended filters of filterpy, one after the other, and the same thresholds; to check ours; about 200 "
    "times slower on the gas pipeline",
    "fusion_sfdia.learning.builders:filterpy_bank",
    memory=STATE,
    most_faults=1,
    learns=True,
    reference=True,
    kind="ekf",
)
register_detector(
    "filterpy-ukf",
    "fusing-ukf with the unscented filters of filterpy, as filterpy-ekf; about 170 times slower on the gas pipeline",
    "fusion_sfdia.learning.builders:filterpy_bank",
    memory=STATE,
    most_faults=1,
    learns=True,
    reference=True,
    kind="ukf",
)
register_detector(
    "loo-chi2",
    "extended Kalman filter with exact leave-one-out chi-square tests of the present sample; isolates by sequential "
    "elimination",
    "fusion_sfdia.detectors.kalman_banks.leave_one_out_bank:LeaveOneOutBank",
    memory=STATE,
    window=1,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "loo-glr",
    "loo-chi2 with generalised likelihood ratios over fault onsets in the last 15 samples (Willsky and Jones 1976)",
    "fusion_sfdia.detectors.kalman_banks.leave_one_out_bank:LeaveOneOutBank",
    memory="15 samples",
    window=15,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "robust-glr",
    "loo-glr on the plant augmented by what it does not know: biases and ramps of sensors compete with jumps and drifts "
    "of parameters and inputs and with errors of state equations; isolates sensors, or reports the process",
    "fusion_sfdia.detectors.kalman_banks.robust_bank:RobustBank",
    memory="32 and 256 samples",
    tests_process=True,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "frozen-model",
    "extended Kalman filter commissioned on healthy data and then frozen; means of its innovations over 1 to 240 samples, "
    "with limits from blocks that were left out, are explained by one sensor, by one unknown of the model, or by neither",
    "fusion_sfdia.learning.builders:frozen_model",
    memory="240 samples",
    learns=True,
    tests_process=True,
    commissions=True,
)
register_detector(
    "mhe-l1",
    "extended Kalman filter with moving-horizon estimation (Rao, Rawlings and Lee 2001) of constant faults under an "
    "L1 penalty (Kim, Koh, Boyd and Gorinevsky 2009); horizons of 1, up to 7 and up to 14 samples",
    "fusion_sfdia.detectors.kalman_banks.moving_horizon_bank:MovingHorizon",
    memory="8 to 14 samples",
    window=15,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "kf-chi2",
    "extended Kalman filter with a test of each innovation; isolates the largest, does not accommodate",
    "fusion_sfdia.detectors.kalman_banks.central_filter:CentralFilter",
    memory=STATE,
    most_faults=1,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "kf-window",
    "extended Kalman filter with chi-square tests of each innovation, of its present value and of its sum of squares "
    "over 15 samples; isolates the largest",
    "fusion_sfdia.learning.builders:sequential",
    memory="15 samples",
    rule="window",
)
register_detector(
    "kf-cusum",
    "extended Kalman filter with two-sided cumulative sums of each innovation for a shift of one standard deviation "
    "(Page 1954), limits by Siegmund's approximation, and a test of its present value (Lucas 1982); isolates the "
    "largest",
    "fusion_sfdia.learning.builders:sequential",
    memory="cumulative sums",
    rule="cusum",
)
register_detector(
    "kf-ewma",
    "extended Kalman filter with an exponentially weighted moving average of each innovation, weight 0.2, and a test "
    "of its present value (Lucas and Saccucci 1990); isolates the largest",
    "fusion_sfdia.learning.builders:sequential",
    memory="factor 0.8 a sample",
    rule="ewma",
)
register_detector(
    "loo-window",
    "kf-window on leave-one-out innovations; isolates by sequential elimination",
    "fusion_sfdia.learning.builders:sequential",
    memory="15 samples",
    rule="window",
    leave_one_out=True,
)
register_detector(
    "loo-cusum",
    "kf-cusum on leave-one-out innovations; isolates by sequential elimination",
    "fusion_sfdia.learning.builders:sequential",
    memory="cumulative sums",
    rule="cusum",
    leave_one_out=True,
)
register_detector(
    "loo-ewma",
    "kf-ewma on leave-one-out innovations; isolates by sequential elimination",
    "fusion_sfdia.learning.builders:sequential",
    memory="factor 0.8 a sample",
    rule="ewma",
    leave_one_out=True,
)
register_detector(
    "uio",
    "unknown-input filter, unaffected by errors of the plant's inputs (Kitanidis 1987; Gillijns and De Moor 2007), "
    "with leave-one-out chi-square tests; isolates by sequential elimination",
    "fusion_sfdia.detectors.kalman_banks.unknown_input:UnknownInputFilter",
    memory=STATE,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "multiple-model",
    "GPB1 multiple-model filter (Ackerson and Fu 1970), a mode for healthy sensors and one per sensor with ten times "
    "its noise; isolates the most probable",
    "fusion_sfdia.detectors.kalman_banks.multiple_model:MultipleModel",
    memory="probabilities of the models",
    most_faults=1,
)
register_detector(
    "limits",
    "fixed limits on each reading and on its change per sample, learnt from healthy data; isolates every sensor beyond them",
    "fusion_sfdia.learning.builders:fixed_limits",
    memory="1 sample",
    learns=True,
)
register_detector(
    "limits-ewma",
    "limits, and a limit on the exponentially weighted moving average of each reading (Lucas and Saccucci 1990)",
    "fusion_sfdia.learning.builders:ewma_limits",
    memory="EWMA, factor 0.8 a sample",
    learns=True,
)
register_detector(
    "pca",
    "principal components of healthy data in units of the sensors' noise, retained above the Marchenko-Pastur edge, "
    "with T2, SPE and contribution tests; isolates by reconstruction (Alcala and Qin 2009)",
    "fusion_sfdia.learning.builders:principal_components",
    memory=NONE,
    most_faults=3,
    learns=True,
)
register_detector(
    "dynamic-pca",
    "pca on the present readings and the two before them (Ku 1995)",
    "fusion_sfdia.learning.builders:principal_components",
    memory="3 samples",
    most_faults=3,
    learns=True,
    lags=2,
)
register_detector(
    "one-class",
    "one-class support vector machine on readings whitened by the components of pca (Schoelkopf 2001; scikit-learn); "
    "isolates by reconstruction",
    "fusion_sfdia.learning.builders:one_class",
    memory=NONE,
    most_faults=3,
    learns=True,
)
register_detector(
    "structural-residuals",
    "residual generators of structural analysis (Krysander 2008; faultdiagnosistoolbox), limits learnt from healthy "
    "data; isolates the minimal diagnosis; needs scalar equations",
    "fusion_sfdia.learning.builders:structural_residuals",
    memory="1 sample and observers",
    most_faults=3,
    learns=True,
)
register_detector(
    "adaptive-threshold",
    "observers and algebraic residuals with thresholds that bounded noise cannot cross at a steady load; isolates by "
    "diagnosis sets (Kougiatsos 2024); without scalar equations, first-order bounds on predicted readings",
    "fusion_sfdia.learning.builders:bounded",
    memory="observers; alarms latch",
)
register_detector(
    "adaptive-threshold:paper",
    "adaptive-threshold with the published constants of the threshold (10) (Kougiatsos 2024)",
    "fusion_sfdia.learning.builders:adaptive_threshold",
    memory="observers; alarms latch",
    mode="paper",
)
register_detector(
    "adaptive-threshold:calibrated",
    "adaptive-threshold with margins that reproduce the published pattern of alarms (Kougiatsos 2024)",
    "fusion_sfdia.learning.builders:adaptive_threshold",
    memory="observers; alarms latch",
    mode="calibrated",
)
register_detector(
    "chebyshev",
    "residuals of one-step predictions with thresholds of 5 standard deviations, without filter memory; in a "
    "network, one diagnoser per area with consensus (Boem 2018, (15) corrected)",
    "fusion_sfdia.detectors.stochastic_thresholds.chebyshev:Chebyshev",
    memory=NONE,
    lam=0.0,
    alpha=CHEBYSHEV_ALPHA,
)
register_detector(
    "chebyshev:corrected",
    "chebyshev with the published filter parameter 0.3 and 2 standard deviations; does not isolate (Boem 2018)",
    "fusion_sfdia.detectors.stochastic_thresholds.chebyshev:Chebyshev",
    memory="residuals, factor 0.3 a sample",
    accommodate=False,
)
register_detector(
    "chebyshev:paper",
    "chebyshev:corrected with (15) and (17) as printed; does not isolate (Boem 2018)",
    "fusion_sfdia.detectors.stochastic_thresholds.chebyshev:Chebyshev",
    memory="residuals, factor 0.3 a sample",
    mode="paper",
    accommodate=False,
)
register_detector(
    "virtual-sensors",
    "modules of adaptive-threshold with guaranteed intervals of the faults; readings corrected by the middle of "
    "their interval feed the other modules (Kougiatsos 2022)",
    "fusion_sfdia.detectors.adaptive_thresholds.virtual_sensors:VirtualSensors",
    memory="observers; intervals of a fault since its alarm",
)
