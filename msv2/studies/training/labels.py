"""What the tables of training call things, and the paper's values and the project's targets beside them; needs no torch."""

TABLES = ("representations", "ablation", "pruning", "latency")
"""What can be asked for alone."""

SMFR, MMFR, OURS, PLAIN = "SMFR", "MMFR", "ours", "ours without opacity enhancement"
"""Foveated representations; the last is the predecessor's."""

PAPER = {
    SMFR: {"fps": 125.9, "storage_mb": 161.6, "hvsq_e5": (2.12, 10.1, 21.7, 28.3)},
    MMFR: {"fps": 52.6, "storage_mb": 311.0, "hvsq_e5": (2.12, 1.87, 1.79, 1.76)},
    OURS: {"fps": 102.2, "storage_mb": 171.8, "hvsq_e5": (2.12, 2.10, 2.09, 2.08)},
}
"""The paper's table of FR methods: means of 13 scenes, frames per second of a Jetson Xavier."""

PREDECESSOR_PERCENT = (100.0, 40.1, 21.8, 17.4)
"""Points per level of the predecessor's model of the bicycle scene, percent of L1's."""

PAPER_FEWER_PERCENT = 33.0
"""The paper's largest cut of points in R3 and R4 by opacity enhancement, at equal HVSQ."""

DENSE, DECAYED, PRUNED, TUNED = "dense", "+ scale decay", "+ CE pruning", "+ HVSQ fine-tuning of L1"
FOVEATED, ENHANCED = "+ foveated levels", "+ opacity enhancement"

PAPER_SPEED = {DENSE: 1.0, DECAYED: 1.6, PRUNED: 5.8, FOVEATED: 7.4, ENHANCED: 7.4 * 1.07}
"""The paper's frame rates over the dense model's, means of 13 scenes on a Jetson Xavier; the last is its 7 % more."""

PAPER_SIZE_PERCENT = {DENSE: 100.0, PRUNED: 15.0, FOVEATED: 16.0}
"""The paper's model size, percent of the dense model's."""

CRITERION_LABELS = {"ce": "CE", "importance": "importance (LightGS)", "count": "count (opacity)", "random": "random"}

TARGET_DENSE_PSNR = {"fern": 22.0, "bonsai": 27.0}
"""Least PSNR of the dense model on test views, dB, by scene."""

TARGET_PSNR_PERCENT = {"H": 99.0, "M": 98.0, "L": 97.0}
"""Least PSNR of L1 on test views, percent of the dense model's, by variant."""

TARGET_CUT = {"H": 3.0}
"""How many times fewer intersections a frame of L1 has at least than the dense model's, by variant."""

TARGET_HVSQ_EXCESS_PERCENT = 5.0
"""What a level's HVSQ at its pooling may be above L1's."""

TARGET_STORAGE_PERCENT = 6.5
"""What levels may add to L1's storage."""

TARGET_SMFR_TIMES = 2.0
"""How many times ours SMFR's HVSQ of L4 is at least ("several times worse")."""


def reached(good: bool) -> str:
    """A target's verdict."""
    return "reached" if good else "missed"
