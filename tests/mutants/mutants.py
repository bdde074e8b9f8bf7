"""Small changes of the code that change an answer, each with the test that has to fail where it is made.

`old` is text that stands once in a file of the library: short, so that other edits of the file leave it alone. A test may name
several cases; it has to fail in one. `quick` ones are of code that is not compiled, with tests of a second.
"""

from __future__ import annotations

from typing import NamedTuple


class Mutant(NamedTuple):
    """In `file` of the library `old` becomes `new`, and `test` fails."""

    file: str
    old: str
    new: str
    test: str
    quick: bool = False

    def __str__(self) -> str:
        return f"{self.file}: {self.old!r} -> {self.new!r} ({self.test})"


def mutated(text: str, mutant: Mutant) -> str:
    """The text of a file with the change. ValueError where `old` does not stand in it exactly once."""
    if (count := text.count(mutant.old)) != 1:
        raise ValueError(
            f"{mutant.old!r} stands {count} times in {mutant.file}, expected once; change `old` of this mutant in "
            "tests/mutants/mutants.py to what the code has now, or leave the mutant out where its code is gone"
        )
    return text.replace(mutant.old, mutant.new)


MUTANTS = (
    Mutant(
        "fusion_sfdia/learning/windows.py",
        "own * ri - np.where(past, ij * rj, 0.0)",
        "own * ri",
        "tests/learning/test_learning_windows.py::test_errors_are_those_of_conditional_means_with_and_without_the_own_past",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/learning/windows.py",
        "found[: w - 1] = np.nan",
        "found[:0] = np.nan",
        "tests/learning/test_learning_windows.py::test_a_mean_needs_half_of_the_rows_of_its_window_and_has_the_same_bits_in_any_piece_of_a_log",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/learning/held_out.py",
        "np.sqrt(variance * (1 + 1 / count))",
        "np.sqrt(variance)",
        "tests/learning/test_learning_limits.py::test_a_tolerance_limit_holds_the_next_value_as_often_as_stated",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/learning/causes.py",
        "partner[s] >= 0 and left",
        "partner[s] < 0 and left",
        "tests/learning/test_learning_monitor.py::test_of_two_sensors_that_only_explain_each_other_it_is_one_or_the_other",
        quick=False,
    ),
    Mutant(
        "fusion_sfdia/learning/judging.py",
        "(how_many >= 3)",
        "(how_many >= 30)",
        "tests/learning/test_learning_monitor.py::test_all_columns_that_stop_at_once_are_the_recorder",
        quick=False,
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/robust_bank.py",
        "(age <= FOLLOWED_FOR)",
        "(age < 0)",
        "tests/kalman_banks/test_robust_bank.py::test_outliers_that_the_estimate_follows_name_no_sensor_and_seldom_the_process",
    ),
    Mutant(
        "fusion_sfdia/adaptive_thresholds/adaptive_threshold.py",
        "/ self.plant.dt\n        rates",
        "\n        rates",
        "tests/adaptive_thresholds/test_adaptive_threshold.py::test_a_load_step_raises_no_alarm_and_errors_keep_their_bounds",
    ),
    Mutant(
        "fusion_sfdia/adaptive_thresholds/monitoring.py",
        "held = np.where(a > 0, (1 - lam) / some, dt)",
        "held = np.where(a > 0, 1 - lam, dt)",
        "tests/adaptive_thresholds/test_monitoring.py::test_a_step_of_an_observer_checked_by_hand",
    ),
    Mutant(
        "fusion_sfdia/adaptive_thresholds/monitoring.py",
        "+ gain * s.bound[..., e]) + moved",
        "+ gain * s.bound[..., e])",
        "tests/adaptive_thresholds/test_monitoring.py::test_a_step_of_an_observer_checked_by_hand",
    ),
    Mutant(
        "fusion_sfdia/adaptive_thresholds/monitoring.py",
        "np.minimum(before, reading), np.maximum(before, reading)",
        "np.maximum(before, reading), np.maximum(before, reading)",
        "tests/adaptive_thresholds/test_monitoring.py::test_a_step_of_an_observer_checked_by_hand",
    ),
    Mutant(
        "fusion_sfdia/adaptive_thresholds/monitoring.py",
        "+ rate * error[:, e]",
        "- rate * error[:, e]",
        "tests/adaptive_thresholds/test_monitoring.py::test_a_step_of_an_observer_checked_by_hand",
    ),
    Mutant(
        "fusion_sfdia/adaptive_thresholds/monitoring.py",
        "/ 2 @ s.unproved[e, columns]",
        "@ s.unproved[e, columns]",
        "tests/adaptive_thresholds/test_monitoring.py::test_unproved_slopes_and_rounding_widen_bounds",
    ),
    Mutant(
        "fusion_sfdia/adaptive_thresholds/monitoring.py",
        "firing[b, i] = fired[b, i] or abs",
        "firing[b, i] = abs",
        "tests/adaptive_thresholds/test_monitoring.py::test_decisions_checked_by_hand",
    ),
    Mutant(
        "fusion_sfdia/commissioning/noise.py",
        "PRIOR = 10.0",
        "PRIOR = 1000.0",
        "tests/commissioning/test_noise.py::test_process_noise_that_is_not_there_becomes_small_but_not_zero",
    ),
    Mutant(
        "fusion_sfdia/commissioning/noise.py",
        "LOUD = 1.5",
        "LOUD = 15.0",
        "tests/commissioning/test_noise.py::test_a_louder_sensor_is_found_before_anything_is_learnt_and_a_fault_is_not_noise",
    ),
    Mutant(
        "fusion_sfdia/commissioning/noise.py",
        "s.own_sigma(s.noise_sigma * float(np.sqrt(f)))",
        "s.own_sigma(s.noise_sigma * float(f))",
        "tests/commissioning/test_noise.py::test_moments_are_the_derivative_of_the_likelihood",
    ),
    Mutant(
        "fusion_sfdia/comparison/calibration.py",
        "return scale / factor, scale * factor",
        "return scale * factor, scale / factor",
        "tests/comparison/test_comparison.py::test_thresholds_are_set_to_the_rate_on_healthy_data_and_keep_it_on_others",
    ),
    Mutant(
        "fusion_sfdia/comparison/calibration.py",
        "rng.integers(runs, size=runs)",
        "np.arange(runs)",
        "tests/comparison/test_comparison.py::test_thresholds_are_set_to_the_rate_on_healthy_data_and_keep_it_on_others",
    ),
    Mutant(
        "fusion_sfdia/evaluation/detection_metrics.py",
        "weights=(below + upto) / 2",
        "weights=upto",
        "tests/evaluation/test_metrics.py::test_auc_is_the_chance_that_a_faulty_sample_scores_higher",
    ),
    Mutant(
        "fusion_sfdia/evaluation/detection_metrics.py",
        "return _rate(alarm, ~_faulty(alarm, active), where)",
        "return _rate(~alarm, ~_faulty(alarm, active), where)",
        "tests/evaluation/test_metrics.py::test_sample_wise_rates_counted_by_hand",
    ),
    Mutant(
        "fusion_sfdia/evaluation/detection_metrics.py",
        "(least > most)",
        "(least >= most)",
        "tests/evaluation/test_metrics.py::test_trial_accuracy_counted_by_hand",
    ),
    Mutant(
        "fusion_sfdia/evaluation/diagnose.py",
        "if 2 * np.sum(seen) < t.size",
        "if np.sum(seen) < 0",
        "tests/evaluation/test_verdicts.py::test_no_blind_sample_or_log_looks_healthy",
    ),
    Mutant(
        "fusion_sfdia/evaluation/diagnose.py",
        "np.sum(named) / 2, LASTING - 1",
        "2 * t.size, LASTING - 1",
        "tests/evaluation/test_verdicts.py::test_no_blind_sample_or_log_looks_healthy",
    ),
    Mutant(
        "fusion_sfdia/evaluation/fault_kinds.py",
        "NORMAL = 1.96",
        "NORMAL = 0.98",
        "tests/evaluation/test_fault_kinds.py::test_intervals_hold_the_size",
    ),
    Mutant(
        "fusion_sfdia/evaluation/fault_kinds.py",
        "for p in (0.975, 0.025)",
        "for p in (0.025, 0.975)",
        "tests/evaluation/test_fault_kinds.py::test_noise_is_stated_without_what_a_healthy_sensor_has",
    ),
    Mutant(
        "fusion_sfdia/evaluation/hindsight.py",
        "found[:-shift] |= isolated[shift:]",
        "found[shift:] |= isolated[:-shift]",
        "tests/evaluation/test_hindsight.py::test_readings_before_an_isolation_are_left_out_too",
    ),
    Mutant(
        "fusion_sfdia/evaluation/hindsight.py",
        "LEAD = 15",
        "LEAD = 1",
        "tests/evaluation/test_hindsight.py::test_readings_before_an_isolation_are_left_out_too",
    ),
    Mutant(
        "fusion_sfdia/evaluation/metrics.py",
        "(z / _student_quantile(runs - 1)) ** 2",
        "(z / _student_quantile(runs - 1))",
        "tests/evaluation/test_metrics.py::test_auc_interval_is_that_of_auc_recomputed_without_each_run",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/evaluation/metrics.py",
        "total**2 * runs / max(runs - 1, 1)",
        "total**2 * runs",
        "tests/evaluation/test_metrics.py::test_rate_over_runs_is_wilson_of_all_samples_at_most",
    ),
    Mutant(
        "fusion_sfdia/evaluation/metrics.py",
        "variance = runs / (runs - 1) * np.sum",
        "variance = np.sum",
        "tests/evaluation/test_metrics.py::test_interval_of_a_mean_is_students_and_of_a_ratio_that_of_its_residuals",
    ),
    Mutant(
        "fusion_sfdia/evaluation/metrics.py",
        "(runs - 1) / runs * np.sum((parts",
        "runs / (runs - 1) * np.sum((parts",
        "tests/evaluation/test_metrics.py::test_auc_interval_is_that_of_auc_recomputed_without_each_run",
    ),
    Mutant(
        "fusion_sfdia/identification/choice.py",
        "sigma=float(np.sqrt(factor) * s.noise_sigma)",
        "sigma=float(factor * s.noise_sigma)",
        "tests/identification/test_choice.py::test_a_fresh_log_is_predicted_as_well_as_stated",
    ),
    Mutant(
        "fusion_sfdia/intervals/sivia.py",
        "inside &= target[work.problem].contains(values[i])",
        "inside |= target[work.problem].contains(values[i])",
        "tests/intervals/test_sivia.py::test_the_ring",
    ),
    Mutant(
        "fusion_sfdia/intervals/sivia.py",
        "small = np.asarray((relative <= 1).all(axis=0))",
        "small = np.asarray((relative <= 4).all(axis=0))",
        "tests/intervals/test_sivia.py::test_the_ring",
    ),
    Mutant(
        "fusion_sfdia/intervals/sivia.py",
        "return inside & ~outside, outside",
        "return inside | ~outside, outside",
        "tests/intervals/test_sivia.py::test_the_ring",
    ),
    Mutant(
        "fusion_sfdia/intervals/sivia.py",
        "slab.where(lo[i] < hi[i])",
        "slab.where(lo[i] > hi[i])",
        "tests/intervals/test_sivia.py::test_the_ring",
    ),
    Mutant(
        "fusion_sfdia/intervals/sivia.py",
        "relative[:, ~small].argmax(axis=0)",
        "relative[:, ~small].argmin(axis=0)",
        "tests/intervals/test_sivia.py::test_the_ring",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "AS_BIAS = 2 / 3",
        "AS_BIAS = 3 / 2",
        "tests/kalman_banks/test_competition.py::test_the_window_with_more_evidence_explains_a_hypothesis",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "LEAST_WEIGHT = 0.1",
        "LEAST_WEIGHT = 0.9",
        "tests/kalman_banks/test_competition.py::test_alternatives_to_the_accepted_one_are_those_within_the_margin",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "more = value_at(evidence.sensor - evidence.one_sample, sensor)",
        "more = value_at(evidence.one_sample - evidence.sensor, sensor)",
        "tests/kalman_banks/test_competition.py::test_a_sensor_is_absorbed_where_the_windows_know_more_of_it_than_the_sample",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "lead = value_at(of_sensors, worst) - of_process",
        "lead = value_at(of_sensors, worst) + of_process",
        "tests/kalman_banks/test_competition.py::test_without_rivals_the_present_sample_is_that_of_the_leave_one_out_bank",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "(lead > limits.process_margin)",
        "(lead > limits.sensor_margin)",
        "tests/kalman_banks/test_competition.py::test_a_cause_is_accepted_by_its_lead_over_the_other_kind",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "(every > top - margin)",
        "(every > top - 2 * margin)",
        "tests/kalman_banks/test_competition.py::test_suspects_are_those_within_the_margin_of_the_best",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "np.where(led * sign > 0, led + sign, sign)",
        "np.where(led * sign > 0, sign, sign)",
        "tests/kalman_banks/test_competition.py::test_a_lead_is_counted_while_the_fault_has_its_sign",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "- np.log1p(known) - present.handicap",
        "- present.handicap",
        "tests/kalman_banks/test_competition.py::test_a_second_sensor_competes_with_what_begins_now_on_the_readings_that_are_left",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "ABSORBED = 2.0",
        "ABSORBED = 200.0",
        "tests/kalman_banks/test_competition.py::test_an_earlier_onset_is_preferred_where_it_is_clearly_the_likelier_one",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/competition.py",
        "PRIOR = 1e-3",
        "PRIOR = 1e-1",
        "tests/kalman_banks/test_competition.py::test_before_any_reading_each_cause_is_true_once_in_a_thousand",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/freed_estimates.py",
        "x = x - change * size[..., None]",
        "x = x + change * size[..., None]",
        "tests/kalman_banks/test_freed_estimates.py::test_the_effect_of_a_fault_and_its_variance_are_removed",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/freed_estimates.py",
        "1.0 / information + doubt * size**2",
        "1.0 / information",
        "tests/kalman_banks/test_freed_estimates.py::test_the_estimate_moves_to_a_difference_of_the_process",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/freed_estimates.py",
        "* np.sqrt(weight))[..., None, :]",
        "* weight)[..., None, :]",
        "tests/kalman_banks/test_freed_estimates.py::test_alternatives_widen_the_covariance_by_their_effects",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/freed_estimates.py",
        "np.where(frozen, 0.0, sd**2)",
        "np.where(frozen, 0.0, sd)",
        "tests/kalman_banks/test_freed_estimates.py::test_unknowns_get_their_prior_spread_again_but_for_frozen_ones",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/hypotheses.py",
        "by_now / np.maximum(age, 1.0)[..., None]",
        "by_now * np.maximum(age, 1.0)[..., None]",
        "tests/kalman_banks/test_hypotheses.py::test_sizes_before_any_reading",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/hypotheses.py",
        "change[..., :n, p:] = self.rates",
        "change[..., :n, p:] = np.swapaxes(self.rates, -1, -2)",
        "tests/kalman_banks/test_hypotheses.py::test_effects_act_on_one_sensor_at_the_onset_or_in_each_step",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/hypotheses.py",
        "return Effect(np.ones(slots), change, p)",
        "return Effect(np.ones(slots), change, 0)",
        "tests/kalman_banks/test_hypotheses.py::test_effects_act_on_one_sensor_at_the_onset_or_in_each_step",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/hypotheses.py",
        "SENSOR_SIZE = 20.0",
        "SENSOR_SIZE = 2.0",
        "tests/kalman_banks/test_hypotheses.py::test_large_faults_lose_little_of_their_evidence_by_the_sizes_that_are_expected",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/hypotheses.py",
        "PARAMETER_SIZE = 10.0",
        "PARAMETER_SIZE = 0.1",
        "tests/kalman_banks/test_hypotheses.py::test_large_faults_lose_little_of_their_evidence_by_the_sizes_that_are_expected",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/hypotheses.py",
        "UNNAMED = 6.0",
        "UNNAMED = 0.0",
        "tests/kalman_banks/test_hypotheses.py::test_a_cause_without_a_name_has_a_twentieth_of_the_odds_of_one_with_a_name",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/leave_one_out.py",
        "u[runs] -= column * (u[one][:, None] / pivot)",
        "u[runs] += column * (u[one][:, None] / pivot)",
        "tests/kalman_banks/test_leave_one_out.py::test_few_states_of_a_batch_are_updated_as_those_of_each_run",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/leave_one_out.py",
        "return 1.0 / self.weight",
        "return self.weight",
        "tests/kalman_banks/test_leave_one_out.py::test_a_missing_reading_equals_a_deleted_one",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/leave_one_out.py",
        "local = gains * -found.innovation[..., None]",
        "local = gains * found.innovation[..., None]",
        "tests/kalman_banks/test_leave_one_out.py::test_every_local_filter_equals_the_one_that_deletes_its_sensor",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/leave_one_out.py",
        "return self.whitened * self.innovation",
        "return np.abs(self.whitened)",
        "tests/kalman_banks/test_leave_one_out.py::test_chi_square_is_chi_square_with_one_degree_of_freedom",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/likelihood_window.py",
        "LEAST_INFORMATION = 1e-3",
        "LEAST_INFORMATION = 1e3",
        "tests/kalman_banks/test_likelihood_window.py::test_residuals_and_thresholds_are_those_of_the_definition",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/likelihood_window.py",
        "* (expected / (1 + expected)) - np.log1p(expected))",
        "* (expected / (1 + expected)) + np.log1p(expected))",
        "tests/kalman_banks/test_competition.py::test_evidence_of_the_sample_is_that_of_a_size_before_any_reading",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/likelihood_window.py",
        "added = -np.einsum(",
        "added = np.einsum(",
        "tests/kalman_banks/test_likelihood_window.py::test_readings_that_are_more_add_their_product_with_the_change_of_the_innovation",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/parameter_walk.py",
        "ONE_SIDED = 4.0",
        "ONE_SIDED = 400.0",
        "tests/kalman_banks/test_parameter_walk.py::test_a_walk_as_stated_adds_nothing_and_the_fastest_a_tenth_of_the_prior_deviation",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/parameter_walk.py",
        "(np.exp(now.rate) - 1) * (UNIT * sd) ** 2",
        "np.exp(now.rate) * (UNIT * sd)",
        "tests/kalman_banks/test_parameter_walk.py::test_a_walk_as_stated_adds_nothing_and_the_fastest_a_tenth_of_the_prior_deviation",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/parameter_walk.py",
        "FADE / (2 - FADE) * gained",
        "(2 - FADE) / FADE * gained",
        "tests/kalman_banks/test_parameter_walk.py::test_a_walk_as_stated_adds_nothing_and_the_fastest_a_tenth_of_the_prior_deviation",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/parameter_walk.py",
        "now.corrections + FADE * (correction - now.corrections)",
        "now.corrections + FADE * (np.abs(correction) - now.corrections)",
        "tests/kalman_banks/test_parameter_walk.py::test_white_corrections_are_no_walk",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/parameter_walk.py",
        "np.where(fast, UP, -DOWN)",
        "np.where(fast, -DOWN, UP)",
        "tests/kalman_banks/test_parameter_walk.py::test_a_walk_as_stated_adds_nothing_and_the_fastest_a_tenth_of_the_prior_deviation",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/quiet.py",
        "UNSURE = 0.7",
        "UNSURE = 7.0",
        "tests/kalman_banks/test_quiet.py::test_noise_is_too_quiet_with_at_most_its_probability",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/quiet.py",
        "change * change / (2 * (sigma[i] * sigma[i]))",
        "change * change / (sigma[i] * sigma[i])",
        "tests/kalman_banks/test_quiet.py::test_noise_that_becomes_smaller_is_found_and_one_that_was_small_is_not",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/quiet.py",
        "SHOWN = 16",
        "SHOWN = 0",
        "tests/kalman_banks/test_quiet.py::test_noise_is_too_quiet_with_at_most_its_probability",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/quiet.py",
        "SLOWER = 0.1",
        "SLOWER = 1.0",
        "tests/kalman_banks/test_quiet.py::test_a_frozen_reading_is_found_after_twice_the_pairs",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/quiet.py",
        "gammaincinv(PAIRS / 2, false_alarm)",
        "gammaincinv(PAIRS, false_alarm)",
        "tests/kalman_banks/test_quiet.py::test_noise_is_too_quiet_with_at_most_its_probability",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/quiet.py",
        "CUT = 4.0",
        "CUT = 0.4",
        "tests/kalman_banks/test_quiet.py::test_noise_that_becomes_smaller_is_found_and_one_that_was_small_is_not",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "MEDIAN = 0.45493642311957283",
        "MEDIAN = 1.0",
        "tests/kalman_banks/test_reading_noise.py::test_the_size_is_the_variance_of_the_noise",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "STEP, FIRST = 0.025, 4.0",
        "STEP, FIRST = 0.25, 4.0",
        "tests/kalman_banks/test_reading_noise.py::test_noise_as_stated_is_hardly_ever_taken_as_larger",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "TOGETHER = 0.2",
        "TOGETHER = 0.0",
        "tests/kalman_banks/test_reading_noise.py::test_what_all_sensors_have_in_common_is_followed_faster_than_what_one_has",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "CLIP = 3.0",
        "CLIP = 30.0",
        "tests/kalman_banks/test_reading_noise.py::test_an_outlier_counts_as_a_reading_three_deviations_from_what_the_others_predict",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "SUPPOSED, WEIGHT = 0.8, 8.0",
        "SUPPOSED, WEIGHT = 0.0, 8.0",
        "tests/kalman_banks/test_reading_noise.py::test_before_any_reading_noise_is_supposed_to_be_correlated_by_four_fifths",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "(e - last[r, i]) ** 2 / (2 * kappa)",
        "(e - last[r, i]) ** 2 / kappa",
        "tests/kalman_banks/test_reading_noise.py::test_the_correlation_is_that_of_the_noise_in_cut_differences",
    ),
    Mutant(
        "fusion_sfdia/core/slow_noise.py",
        "- 2 * q * (1 - q**n)",
        "+ 2 * q * (1 - q**n)",
        "tests/core/test_slow_noise.py::test_sums_vary_as_the_correlations_of_their_samples_say",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "common[r, l] = shared * usual",
        "common[r, l] = usual",
        "tests/kalman_banks/test_reading_noise.py::test_before_any_reading_noise_is_supposed_to_be_correlated_by_four_fifths",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "max(alone, least[i]) * spread[r, i]",
        "max(alone, least[i])",
        "tests/kalman_banks/test_reading_noise.py::test_sums_vary_as_those_of_noise_with_its_size_and_correlation",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "turned[r, j] -= U[worst, j] * delta",
        "turned[r, j] += U[worst, j] * delta",
        "tests/kalman_banks/test_reading_noise.py::test_an_outlier_counts_as_a_reading_three_deviations_from_what_the_others_predict",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/reading_noise.py",
        "FADE = 1 - 1 / 32  # of `spread`",
        "FADE = 0.0  # of `spread`",
        "tests/kalman_banks/test_reading_noise.py::test_louder_noise_counts_in_the_windows_for_as_long_as_they_have_its_sums",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/sequential_bank.py",
        "share = self.false_alarm / y.shape[-1] / len(self.rules)",
        "share = self.false_alarm / y.shape[-1]",
        "tests/kalman_banks/test_sequential_bank.py::test_alarms_begin_at_most_at_the_stated_rate",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/sequential_bank.py",
        "restart = np.any(isolated, axis=-1)[..., None, None]",
        "restart = np.any(~isolated, axis=-1)[..., None, None]",
        "tests/kalman_banks/test_sequential_bank.py::test_memory_detects_the_weak_bias_that_one_sample_misses",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/sequential_bank.py",
        "room = np.sum(out | isolated, axis=-1) < self.most_faults",
        "room = np.sum(isolated, axis=-1) < self.most_faults",
        "tests/kalman_banks/test_sequential_bank.py::test_a_bank_reports_when_no_more_sensors_may_be_left_out",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/sequential_bank.py",
        "worst = np.argmax(innovations.ratio, axis=-1)",
        "worst = np.argmin(innovations.ratio, axis=-1)",
        "tests/kalman_banks/test_sequential_bank.py::test_without_memory_and_accommodation_it_is_the_one_sample_test",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/sequential_rules.py",
        "OVERSHOOT = 1.166",
        "OVERSHOOT = -1.166",
        "tests/kalman_banks/test_sequential_rules.py::test_the_limit_of_a_cumulative_sum_gives_the_stated_mean_time_between_false_alarms",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/sequential_rules.py",
        "kept**2 * variance + self.lam**2",
        "kept * variance + self.lam**2",
        "tests/kalman_banks/test_sequential_rules.py::test_a_recursion_is_the_textbook_loop_and_does_not_change_without_a_reading",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/sequential_rules.py",
        "np.stack([z, -z], axis=-2) - self.shift / 2",
        "np.stack([z, -z], axis=-2) - self.shift",
        "tests/kalman_banks/test_sequential_rules.py::test_a_recursion_is_the_textbook_loop_and_does_not_change_without_a_reading",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/sequential_rules.py",
        "quantiles = np.sqrt(chdtri(np.arange(1, self.length + 1), share))",
        "quantiles = chdtri(np.arange(1, self.length + 1), share)",
        "tests/kalman_banks/test_sequential_rules.py::test_exact_limits_are_exact_at_every_step",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/standing.py",
        "(now.size * np.sqrt(now.left))",
        "(now.size * now.left)",
        "tests/kalman_banks/test_standing.py::test_noise_is_that_of_the_error_of_the_equation_and_a_share_of_the_change_of_a_state",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/standing.py",
        "np.where(np.any(which, axis=-1), 0.0, now.since)",
        "now.since",
        "tests/kalman_banks/test_standing.py::test_an_accepted_state_keeps_its_estimate_of_before_and_an_equation_its_size",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/standing.py",
        "np.where(fresh, z, now.before)",
        "np.where(fresh, now.before, z)",
        "tests/kalman_banks/test_standing.py::test_an_accepted_state_keeps_its_estimate_of_before_and_an_equation_its_size",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/window_kernels.py",
        "a[run, l, j] += sums[j]",
        "a[run, l, j] += 1.2 * sums[j]",
        "tests/kalman_banks/test_likelihood_window.py::test_residuals_and_thresholds_are_those_of_the_definition",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/window_kernels.py",
        "age[r, k] + 1.0 if k >= 0",
        "age[r, k] + 2.0 if k >= 0",
        "tests/kalman_banks/test_likelihood_window.py::test_every_hypothesis_is_the_filter_on_a_plant_of_which_it_is_true",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/window_kernels.py",
        "to[j] += by * of[j]\n            for i in range(n if r else 0)",
        "to[j] -= by * of[j]\n            for i in range(n if r else 0)",
        "tests/kalman_banks/test_likelihood_window.py::test_residuals_and_thresholds_are_those_of_the_definition",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/window_kernels.py",
        "squares[j] * (spread[j] * spread[j]) > least",
        "squares[j] * spread[j] > least",
        "tests/kalman_banks/test_likelihood_window.py::test_the_best_onset_is_that_with_the_largest_ratio_of_those_with_information",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/window_kernels.py",
        "(age[r, slot[r, j]] * bias if of_slow else 1.0)",
        "(bias if of_slow else 1.0)",
        "tests/kalman_banks/test_competition.py::test_the_window_with_more_evidence_explains_a_hypothesis",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/window_kernels.py",
        "(expected / (1.0 + expected)) - np.log1p(expected)",
        "(expected / (1.0 + expected))",
        "tests/kalman_banks/test_likelihood_window.py::test_the_evidence_is_twice_the_logarithm_of_the_likelihood_ratio_averaged_over_sizes",
    ),
    Mutant(
        "fusion_sfdia/kalman_banks/window_kernels.py",
        "np.sqrt(window / information[r, i])",
        "np.sqrt(one / information[r, i])",
        "tests/kalman_banks/test_likelihood_window.py::test_residuals_and_thresholds_are_those_of_the_definition",
    ),
    Mutant(
        "fusion_sfdia/monitoring/calibration.py",
        "for j, group in enumerate(groups) if j != k for run in group]",
        "for j, group in enumerate(groups) for run in group]",
        "tests/monitoring/test_calibration.py::test_each_group_is_judged_by_a_detector_that_has_not_seen_it",
    ),
    Mutant(
        "fusion_sfdia/monitoring/calibration.py",
        ">= warm_up)",
        "< warm_up)",
        "tests/monitoring/test_calibration.py::test_each_group_is_judged_by_a_detector_that_has_not_seen_it",
    ),
    Mutant(
        "fusion_sfdia/stochastic_thresholds/present_readings.py",
        "inner.readings - self.lam * residual",
        "inner.readings + self.lam * residual",
        "tests/stochastic_thresholds/test_present_readings.py::test_a_removed_fault_leaves_its_uncertainty_and_other_runs_do_not_change",
    ),
    Mutant(
        "fusion_sfdia/stochastic_thresholds/present_readings.py",
        "self.lam * deviation + np.sqrt(variance)",
        "self.lam * deviation - np.sqrt(variance)",
        "tests/stochastic_thresholds/test_chebyshev.py::test_conformal_thresholds_from_healthy_readings",
    ),
    Mutant(
        "fusion_sfdia/stochastic_thresholds/threshold_rules.py",
        "lambda a: 2 / (1 + a**2), lambda p: (2 / p - 1) ** 0.5",
        "lambda a: 2 / (1 + a**2), lambda p: (2 / p + 1) ** 0.5",
        "tests/stochastic_thresholds/test_threshold_rules.py::test_alpha_and_probability_are_inverse",
    ),
    Mutant(
        "fusion_sfdia/stochastic_thresholds/threshold_rules.py",
        'probability("false_alarm", false_alarm) / components',
        'probability("false_alarm", false_alarm)',
        "tests/stochastic_thresholds/test_threshold_rules.py::test_rules_against_numbers_checked_by_hand",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/stochastic_thresholds/threshold_rules.py",
        "np.where(np.isnan(scores), np.inf, scores)",
        "np.where(np.isnan(scores), 0.0, scores)",
        "tests/stochastic_thresholds/test_threshold_rules.py::test_missing_scores_count_as_the_largest",
    ),
    Mutant(
        "fusion_sfdia/study/audit.py",
        "false: Array = np.any(isolated & ~lasting(faulty), axis=-1)",
        "false: Array = np.all(isolated & ~lasting(faulty), axis=-1)",
        "tests/study/test_study_audit.py::test_an_audit_tells_what_a_detector_survives",
    ),
    Mutant(
        "fusion_sfdia/study/audit.py",
        "judged if k else rows",
        "rows if k else judged",
        "tests/study/test_study_audit.py::test_an_audit_tells_what_a_detector_survives",
    ),
    Mutant(
        "fusion_sfdia/study/audit.py",
        "SURVIVED = 0.02",
        "SURVIVED = 0.5",
        "tests/study/test_study_audit.py::test_an_audit_tells_what_a_detector_survives",
    ),
    Mutant(
        "fusion_sfdia/study/errors.py",
        "OUTLIERS, OUTLIER_SIZE = 0.01, 10.0",
        "OUTLIERS, OUTLIER_SIZE = 0.1, 10.0",
        "tests/study/test_study_errors.py::test_noise_has_the_variance_that_its_name_states",
    ),
    Mutant(
        "fusion_sfdia/study/errors.py",
        "-r for r in rho",
        "r for r in rho",
        "tests/study/test_study_errors.py::test_noise_has_the_variance_that_its_name_states",
    ),
    Mutant(
        "fusion_sfdia/study/protocol.py",
        "_signed(rng, size * plant.sensor_sigma[i])",
        "_signed(rng, size)",
        "tests/study/test_study_audit.py::test_a_trial_knows_which_sensor_fails_when",
    ),
    Mutant(
        "fusion_sfdia/study/protocol.py",
        "off = order if case.off < 0 else order[: case.off]",
        "off = order if case.off < 0 else order[case.off :]",
        "tests/study/test_study_audit.py::test_an_audit_tells_what_a_detector_survives",
    ),
    Mutant(
        "fusion_sfdia/study/random_plants.py",
        "size = rng.uniform(0.5, 0.97)",
        "size = rng.uniform(0.97, 1.2)",
        "tests/study/test_study_audit.py::test_random_plants_are_plants",
    ),
    Mutant(
        "fusion_sfdia/study/truths.py",
        "PULSE = 20",
        "PULSE = 2",
        "tests/study/test_study_audit.py::test_changes_of_the_process_begin_and_end_as_stated",
    ),
    Mutant(
        "fusion_sfdia/study/truths.py",
        "self.size * min((since + dt) / length, 1.0)",
        "self.size * min((length - since) / length, 1.0)",
        "tests/study/test_study_audit.py::test_changes_of_the_process_begin_and_end_as_stated",
    ),
    Mutant(
        "fusion_sfdia/tuning/tail.py",
        "APART = 15",
        "APART = 1",
        "tests/tuning/test_tail.py::test_exceedances_are_counted_with_their_interval",
        quick=True,
    ),
    Mutant(
        "fusion_sfdia/tuning/tail.py",
        "raw = 2 - mean / (mean - 2 * weighted)",
        "raw = mean / (mean - 2 * weighted) - 2",
        "tests/tuning/test_tail.py::test_a_heavy_tail_is_seen_where_the_log_is_long_enough",
    ),
    Mutant(
        "fusion_sfdia/tuning/tail.py",
        "independent = n / _cluster(scores, np.sqrt(u))",
        "independent = n",
        "tests/tuning/test_tail.py::test_clusters_widen_the_interval",
    ),
    Mutant(
        "fusion_sfdia/tuning/tail.py",
        "expected / n), [0.025, 0.975]",
        "expected), [0.025, 0.975]",
        "tests/tuning/test_tail.py::test_the_interval_of_an_extrapolated_threshold_holds_the_exact_one",
    ),
    Mutant(
        "fusion_sfdia/tuning/tail.py",
        "spread = 1.96 *",
        "spread = 0.196 *",
        "tests/tuning/test_tail.py::test_a_rate_that_the_log_holds_is_counted",
    ),
    Mutant(
        "fusion_sfdia/core/slow_noise.py",
        "1 + share * (inflation(n, q) - 1)",
        "inflation(n, q)",
        "tests/core/test_slow_noise.py::test_sums_vary_as_the_correlations_of_their_samples_say",
    ),
    Mutant(
        "fusion_sfdia/evaluation/model_health.py",
        "np.log(limit * usual[i])",
        "np.log(limit)",
        "tests/evaluation/test_model_health.py::test_slow_noise_that_is_stated_fits",
    ),
    Mutant(
        "fusion_sfdia/commissioning/slow_noise.py",
        "np.min(deviance)) > RATIO",
        "np.min(deviance)) > 0",
        "tests/commissioning/test_learnt_slow_noise.py::test_white_noise_shows_none",
    ),
    Mutant(
        "fusion_sfdia/tuning/spikes.py",
        "plant.sensor_resolution > 0, 1.0,",
        "plant.sensor_resolution > 0, 0.0,",
        "tests/tuning/test_tune.py::test_coarse_readings_are_learnt_as_such",
    ),
    Mutant(
        "fusion_sfdia/tuning/tune.py",
        "scale = max(scale, min(limit.high, 1.0))",
        "scale = min(scale, 1.0)",
        "tests/tuning/test_tune.py::test_a_rate_that_the_log_cannot_count_is_extrapolated_and_stated",
    ),
)
