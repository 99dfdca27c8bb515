"""Results published in the papers, measured in their own simulators."""

from __future__ import annotations

from samarl.evaluation.summary import Column

# SAMARL, Table I: success rate in % (500 cases). Its social score is on another scale.
PAPER_SUCCESS: dict[Column, dict[str, int]] = {
    Column(90.0, 10, 3): {
        "ORCA": 25,
        "CADRL": 55,
        "SAMARL-PPO": 72,
        "SAMARL-SRNN": 81,
        "SAMARL": 93,
    },
    Column(90.0, 10, 5): {
        "ORCA": 21,
        "CADRL": 54,
        "SAMARL-PPO": 71,
        "SAMARL-SRNN": 82,
        "SAMARL": 89,
    },
    Column(360.0, 10, 5): {
        "ORCA": 23,
        "CADRL": 63,
        "SAMARL-PPO": 72,
        "SAMARL-SRNN": 87,
        "SAMARL": 95,
    },
}
PAPER_NAME = {"ORCA": "ORCA"}  # names of our methods in the paper, by label

# MSA3C (Artificial Intelligence Review, 2024), Tables 2 and 3: CSR %, CR %, APL m, NTC and CIR %
# (500 cases) by scenario and changed fields. The paper has no results of MASAC, which did not
# converge, nor of MSA3C without the temporal-spatial graph (TSG) in 20p3r.
PAPER_CO_PLANNING: dict[tuple[str, str], dict[str, tuple[float, ...]]] = {
    ("5p3r", ""): {
        "MLGA2C": (98.0, 44.2, 26.8, 45.7, 10.2),
        "MSA3C without TSG": (95.6, 29.2, 30.8, 52.5, 6.6),
        "MSA3C": (92.6, 0.9, 27.7, 51.4, 3.0),
        "MSA3CPred": (98.8, 2.4, 28.7, 51.7, 1.2),
        "SARL": (85.2, 12.2, 40.4, 56.5, 4.9),
        "ORCA-PS": (98.4, 2.8, 30.2, 66.4, 1.4),
        "SF": (98.0, 35.5, 33.1, 80.8, 7.3),
    },
    ("10p3r", ""): {
        "MSA3C without TSG": (54.5, 45.9, 39.8, 78.7, 15.5),
        "MSA3C": (80.2, 2.2, 31.8, 71.6, 4.1),
        "MSA3CPred": (99.8, 2.5, 33.1, 65.2, 1.6),
        "ORCA-PS": (92.4, 3.5, 38.2, 89.7, 1.6),
        "SF": (68.2, 77.9, 37.1, 89.4, 9.6),
    },
    ("20p3r", ""): {
        "MSA3C": (61.4, 5.8, 36.9, 81.4, 6.7),
        "MSA3CPred": (92.6, 8.4, 41.2, 81.0, 2.9),
        "ORCA-PS": (60.4, 7.8, 39.5, 102.9, 2.5),
        "SF": (71.2, 135.1, 42.9, 99.0, 12.5),
    },
    ("5p3r", "sensing_range=5.0"): {"MSA3CPred": (99.2, 11.6, 34.2, 65.8, 2.3)},
    ("10p3r", "sensing_range=5.0"): {"MSA3CPred": (97.2, 14.9, 40.2, 79.3, 2.7)},
    ("20p3r", "sensing_range=5.0"): {"MSA3CPred": (89.5, 16.6, 43.6, 84.3, 3.8)},
}
