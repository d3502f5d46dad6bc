"""The names in the tables of training, the paper's values, and the project's targets. The module needs no torch."""

TABLES = ("representations", "ablation", "pruning", "latency")
"""The tables, each of which can be requested alone."""

SMFR, MMFR, OURS, PLAIN = "SMFR", "MMFR", "ours", "ours without opacity enhancement"
"""The foveated representations; the last one is the predecessor's."""

PAPER = {
    SMFR: {"fps": 125.9, "storage_mb": 161.6, "hvsq_e5": (2.12, 10.1, 21.7, 28.3)},
    MMFR: {"fps": 52.6, "storage_mb": 311.0, "hvsq_e5": (2.12, 1.87, 1.79, 1.76)},
    OURS: {"fps": 102.2, "storage_mb": 171.8, "hvsq_e5": (2.12, 2.10, 2.09, 2.08)},
}
"""The paper's table of foveated methods: means of 13 scenes, with frames per second of a Jetson Xavier."""

PREDECESSOR_PERCENT = (100.0, 40.1, 21.8, 17.4)
"""Points per level of the predecessor's model of the bicycle scene, in percent of L1's."""

PAPER_FEWER_PERCENT = 33.0
"""The largest reduction of points in R3 and R4 by opacity enhancement in the paper, at equal HVSQ."""

DENSE, DECAYED, PRUNED, TUNED = "dense", "+ scale decay", "+ pruning", "+ HVSQ fine-tuning of L1"
FOVEATED, ENHANCED = "+ foveated levels", "+ opacity enhancement"

PRUNED_BY_CE = "+ CE pruning"
"""The name of `PRUNED` in reports from before pruning had a criterion of our own."""

PAPER_SPEED = {DENSE: 1.0, DECAYED: 1.6, PRUNED: 5.8, PRUNED_BY_CE: 5.8, FOVEATED: 7.4, ENHANCED: 7.4 * 1.07}
"""The paper's frame rates relative to the dense model, as means of 13 scenes on a Jetson Xavier. The last value adds its 7
%."""

PAPER_SIZE_PERCENT = {DENSE: 100.0, PRUNED: 15.0, PRUNED_BY_CE: 15.0, FOVEATED: 16.0}
"""The paper's model sizes, in percent of the dense model's."""

CRITERION_LABELS = {
    "removal_per_tile": "change per tile", "ce": "CE", "importance": "importance (LightGS)", "count": "count (opacity)",
    "speedy": "sensitivity (Speedy-Splat)", "pup": "log det of Fisher (PUP 3D-GS)", "compact": "learned masks (Compact3DGS)",
    "random": "random"}

PUBLISHED = ("ce", "count", "importance", "speedy", "pup", "compact")
"""The methods of others that ours is to need fewer intersections than, at equal PSNR."""

TARGET_DENSE_PSNR = {"fern": 22.0, "bonsai": 27.0}
"""The least PSNR in dB of the dense model on test views, by scene."""

TARGET_PSNR_PERCENT = {"H": 99.0, "M": 98.0, "L": 97.0}
"""The least PSNR of L1 on test views, in percent of the dense model's, by variant."""

TARGET_CUT = {"H": 3.0}
"""The least factor by which a frame of L1 has fewer intersections than one of the dense model, by variant."""

TARGET_HVSQ_EXCESS_PERCENT = {"validation": 5.0, "test": 10.0}
"""The largest excess of a level's HVSQ, at its pooling, over L1's, by views: the gate reads the validation views."""

TARGET_STORAGE_PERCENT = 6.5
"""The largest storage that levels may add to that of L1."""

TARGET_SMFR_TIMES = 2.0
"""The least ratio of SMFR's HVSQ of L4 to ours ("several times worse")."""


def reached(good: bool) -> str:
    """The verdict on a target."""
    return "reached" if good else "missed"
