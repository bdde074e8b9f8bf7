"""The named detectors: what each is, how it is built for a plant, and what memory it has."""

from __future__ import annotations

from fusion_sfdia.registry import register_detector

FALSE_ALARM = 1e-3  # per step over all sensors, of every detector here
CHEBYSHEV_ALPHA = 5.0  # a component alarms falsely in at most 1/25 of all steps, of Gaussian noise in 6e-7

NONE = "none"
STATE = "state estimate only"

register_detector(
    "fusing-ekf",
    "extended Kalman filters, one without each sensor, with information mixture: statistics (19), (20) of "
    "Shaheen 2024, on its pipeline with its process noise; P0 is the plant's, where the paper has the identity",
    "fusion_sfdia.builders:printed_bank",
    memory=STATE,
    learns=True,
    kind="ekf",
)
register_detector(
    "fusing-ukf",
    "the same of unscented filters as printed, without redrawn sigma points",
    "fusion_sfdia.builders:printed_bank",
    memory=STATE,
    learns=True,
    kind="ukf",
)
register_detector(
    "fusing-enkf",
    "the same of ensemble filters, 40 members",
    "fusion_sfdia.builders:printed_bank",
    memory=STATE,
    learns=True,
    kind="enkf",
)
register_detector(
    "loo-chi2",
    "one extended Kalman filter with exact leave-one-out chi-square statistics and sequential elimination",
    "fusion_sfdia.kalman_banks.leave_one_out_bank:LeaveOneOutBank",
    memory=STATE,
    window=1,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "loo-glr",
    "the same with likelihood ratios over the onsets of the last 15 samples",
    "fusion_sfdia.kalman_banks.leave_one_out_bank:LeaveOneOutBank",
    memory="15 samples",
    window=15,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "mhe-l1",
    "moving-horizon estimation on one extended Kalman filter (Rao, Rawlings and Lee 2001): faults constant over a horizon "
    "with an L1 penalty (Kim, Koh, Boyd and Gorinevsky 2009), in horizons of 1, up to 7 and up to 14 samples",
    "fusion_sfdia.kalman_banks.moving_horizon_bank:MovingHorizon",
    memory="8 to 14 samples",
    window=15,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "kf-chi2",
    "one extended Kalman filter with a test of each innovation; isolates the largest, accommodates nothing",
    "fusion_sfdia.kalman_banks.central_filter:CentralFilter",
    memory=STATE,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "kf-window",
    "one extended Kalman filter; of each sensor the sum of squares of its last 15 normalised innovations, chi-square, and "
    "a test of the present one; isolates and leaves out the largest, until it is readmitted",
    "fusion_sfdia.builders:sequential",
    memory="15 samples",
    rule="window",
)
register_detector(
    "kf-cusum",
    "the same with two-sided cumulative sums against a shift of one standard deviation (Page 1954), limits by Siegmund's "
    "approximation, and a test of the present sample (Lucas 1982)",
    "fusion_sfdia.builders:sequential",
    memory="cumulative sums",
    rule="cusum",
)
register_detector(
    "kf-ewma",
    "the same with exponentially weighted averages of weight 0.2, limits by their variance, and a test of the present "
    "sample (Lucas and Saccucci 1990)",
    "fusion_sfdia.builders:sequential",
    memory="factor 0.8 a sample",
    rule="ewma",
)
register_detector(
    "loo-window",
    "kf-window on normalised leave-one-out innovations, with sequential elimination",
    "fusion_sfdia.builders:sequential",
    memory="15 samples",
    rule="window",
    leave_one_out=True,
)
register_detector(
    "loo-cusum",
    "kf-cusum on normalised leave-one-out innovations, with sequential elimination",
    "fusion_sfdia.builders:sequential",
    memory="cumulative sums",
    rule="cusum",
    leave_one_out=True,
)
register_detector(
    "loo-ewma",
    "kf-ewma on normalised leave-one-out innovations, with sequential elimination",
    "fusion_sfdia.builders:sequential",
    memory="factor 0.8 a sample",
    rule="ewma",
    leave_one_out=True,
)
register_detector(
    "uio",
    "a filter that no error of the plant's inputs can move (Kitanidis 1987; Gillijns and De Moor 2007) with leave-one-out "
    "chi-square statistics and sequential elimination",
    "fusion_sfdia.kalman_banks.unknown_input:UnknownInputFilter",
    memory=STATE,
    false_alarm=FALSE_ALARM,
)
register_detector(
    "multiple-model",
    "models of healthy sensors and of each one's noise ten times as large, with a Markov chain between them (GPB1); isolates "
    "the most probable",
    "fusion_sfdia.kalman_banks.multiple_model:MultipleModel",
    memory="probabilities of the models",
)
register_detector(
    "limits",
    "fixed limits of each reading and of its change since the last, learnt from healthy data",
    "fusion_sfdia.builders:fixed_limits",
    memory="1 sample",
    learns=True,
)
register_detector(
    "limits-ewma",
    "the same with a limit on the exponentially weighted moving average of each reading, too (Lucas and Saccucci 1990)",
    "fusion_sfdia.builders:ewma_limits",
    memory="EWMA, factor 0.8 a sample",
    learns=True,
)
register_detector(
    "pca",
    "principal components of healthy data in units of the sensors' noise, those above the Marchenko-Pastur edge: T2, SPE "
    "and reconstruction-based contributions, by which it isolates",
    "fusion_sfdia.builders:principal_components",
    memory=NONE,
    learns=True,
)
register_detector(
    "dynamic-pca",
    "the same of present readings and the two before them (Ku 1995)",
    "fusion_sfdia.builders:principal_components",
    memory="3 samples",
    learns=True,
    lags=2,
)
register_detector(
    "one-class",
    "one-class support vector machine (scikit-learn) of readings whitened by the components of pca; isolation by "
    "reconstruction of single readings",
    "fusion_sfdia.builders:one_class",
    memory=NONE,
    learns=True,
)
register_detector(
    "structural-residuals",
    "residuals of structural analysis (faultdiagnosistoolbox), computed from the equations in their own direction, limits "
    "from healthy data, minimal diagnoses; on a plant with scalar equations",
    "fusion_sfdia.builders:structural_residuals",
    memory="1 sample and observers",
    learns=True,
)
register_detector(
    "adaptive-threshold",
    "observers and algebraic residuals with thresholds that bounded noise cannot cross at a steady load, and diagnosis "
    "sets (Kougiatsos 2024); on a plant without scalar equations what bounded noise does to predicted readings, to first "
    "order",
    "fusion_sfdia.builders:bounded",
    memory="observers; alarms latch",
)
register_detector(
    "adaptive-threshold:paper",
    "the same with the constants of (10) as published",
    "fusion_sfdia.builders:adaptive_threshold",
    memory="observers; alarms latch",
    mode="paper",
)
register_detector(
    "adaptive-threshold:calibrated",
    "the same with margins under which the published pattern of modules fires",
    "fusion_sfdia.builders:adaptive_threshold",
    memory="observers; alarms latch",
    mode="calibrated",
)
register_detector(
    "chebyshev",
    "residuals of present readings with stochastic thresholds of 5 standard deviations, in a network by local diagnosers "
    "with consensus (Boem 2018), (15) corrected; no memory in the residuals",
    "fusion_sfdia.stochastic_thresholds.chebyshev:Chebyshev",
    memory=NONE,
    lam=0.0,
    alpha=CHEBYSHEV_ALPHA,
)
register_detector(
    "chebyshev:corrected",
    "the same with the paper's filter parameter 0.3 and 2 standard deviations; isolates no sensor",
    "fusion_sfdia.stochastic_thresholds.chebyshev:Chebyshev",
    memory="residuals, factor 0.3 a sample",
    accommodate=False,
)
register_detector(
    "chebyshev:paper",
    "the same with (15) and (17) as printed",
    "fusion_sfdia.stochastic_thresholds.chebyshev:Chebyshev",
    memory="residuals, factor 0.3 a sample",
    mode="paper",
    accommodate=False,
)
register_detector(
    "virtual-sensors",
    "the modules of adaptive-threshold with guaranteed intervals of the faults, whose middles are taken off the readings "
    "before other modules get them (Kougiatsos 2022)",
    "fusion_sfdia.adaptive_thresholds.virtual_sensors:VirtualSensors",
    memory="observers; intervals of a fault since its alarm",
)
