SCENARIO = "robustness"
