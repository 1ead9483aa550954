"""What the scores of `bench_restore.py` amount to, next to the bounds.

`cases` maps the name of a case to its scores by method; methods that failed have an error instead of scores and count as worst.
"""

from typing import Any

import numpy as np
from restore_methods import DIFFUSION_PEERS, PATCH_PEERS, PEERS

MIN_LOWEST_FRACTION, MAX_RATIO = 0.8, 1.1  # Limits of the patch distance.
BOUNDARY_BOUNDS = (0.9, 1.1)
MAX_LOW_BAND_LOSS = 0.3  # dB
FAILED_RATIO = 1000.0  # Stands for a method that failed.

Cases = dict[str, dict[str, dict[str, Any]]]


def summarize_quality(cases: Cases) -> dict[str, Any]:
    """Return how often Farfield has the lowest patch distance and no seam, and its largest ratio to the best peer."""
    methods = [name for name in next(iter(cases.values())) if name != "truth"]
    summary: dict[str, Any] = {"cases": len(cases)}
    if "farfield" in methods:
        summary |= {"distance": compare_distances(cases), "boundary": summarize_boundaries(cases, "farfield")}
    summary["mean_distance"] = {name: mean_of(cases, name, "distance") for name in ["truth", *methods]}
    summary["mean_distance_to_truth"] = {name: mean_of(cases, name, "distance_to_truth") for name in methods}
    summary["mean_boundary"] = {name: mean_of(cases, name, "boundary") for name in ["truth", *methods]}
    for label in ("within", "within_relative_to_truth"):
        summary[f"boundary_{label}"] = {name: summarize_boundaries(cases, name)[label] for name in ["truth", *methods]}
    summary["mean_seconds"] = {name: mean_of(cases, name, "seconds") for name in methods}
    return summary | {"failed": find_failures(cases)}


def summarize_pictures(cases: Cases) -> dict[str, Any]:
    """Return the mean scores of each method, how often Farfield has the lowest FLIP, and its contour error relative to the best peer."""
    methods = [name for name in next(iter(cases.values())) if name != "truth"]
    means = {
        score: {name: mean_of(cases, name, score) for name in methods}
        for score in ("contours", "flip", "false_edge", "low_band_db", "seconds")
    }
    summary: dict[str, Any] = {"cases": len(cases), "means": means, "failed": find_failures(cases)}
    peers = [name for name in methods if name in PEERS]
    if "farfield" in methods and peers:
        best_peer = min(means["contours"][name] for name in peers)
        lowest = [scores["farfield"]["flip"] <= min(scores[name].get("flip", np.inf) for name in peers) for scores in cases.values()]
        diffusion = [name for name in peers if name in DIFFUSION_PEERS]
        low_band = [
            scores["farfield"]["low_band_db"] >= max(scores[name]["low_band_db"] for name in diffusion) - MAX_LOW_BAND_LOSS
            for scores in cases.values()
            if diffusion
        ]
        summary |= {
            "contours_to_best_peer": round(means["contours"]["farfield"] / max(best_peer, 1e-9), 3),
            "flip_lowest": mean(lowest),
            "low_band_near_best_diffusion": mean(low_band),
        }
    return summary


def compare_distances(cases: Cases) -> dict[str, Any]:
    """Return how the patch distance of Farfield compares with the best peer of each case, and of each texture over its masks.

    The distance of the truth is not zero, as a hole is a small sample of its texture; distances below that of the truth say little.
    """
    ratios = {}
    for name, scores in cases.items():
        peer = min((scores[peer].get("distance", np.inf) for peer in PEERS if peer in scores), default=np.inf)
        ratios[name] = round(min(scores["farfield"].get("distance", np.inf) / max(peer, 1e-9), FAILED_RATIO), 3)
    textures = {name.split(", ")[0] for name in cases}
    over_masks = [[value for name, value in ratios.items() if name.split(", ")[0] == texture] for texture in textures]
    below_truth = [scores["farfield"].get("distance", np.inf) <= scores["truth"]["distance"] for scores in cases.values()]
    return {
        "lowest": mean([value <= 1.0 for value in ratios.values()]),
        "lowest_by_texture": mean([np.exp(np.mean(np.log(values))) <= 1.0 for values in over_masks]),
        "lowest_or_below_truth": mean([value <= 1.0 or below for value, below in zip(ratios.values(), below_truth, strict=True)]),
        "lowest_bound": MIN_LOWEST_FRACTION,
        "ratio_to_best_peer": round(float(np.exp(np.mean(np.log(list(ratios.values()))))), 3),
        "above_bound": {name: ratios[name] for name in sorted(ratios, key=ratios.get, reverse=True) if ratios[name] > MAX_RATIO},
        "bound": MAX_RATIO,
    }


def summarize_boundaries(cases: Cases, method: str) -> dict[str, Any]:
    """Return the fraction of cases whose energy across the boundary is within bounds: relative to the rest, to the rest near the hole, and
    to the truth, which is often outside the bounds itself."""
    found = {name: scores[method].get("boundary", np.inf) for name, scores in cases.items()}
    nearby = [scores[method].get("boundary_nearby", np.inf) for scores in cases.values()]
    to_truth = [found[name] / max(scores["truth"]["boundary"], 1e-9) for name, scores in cases.items()]
    return {
        "bounds": BOUNDARY_BOUNDS,
        "within": mean([is_within(value) for value in found.values()]),
        "within_nearby": mean([is_within(value) for value in nearby]),
        "within_relative_to_truth": mean([is_within(value) for value in to_truth]),
        "median_relative_to_truth": round(float(np.median(to_truth)), 3),
        "outside": {name: value if np.isfinite(value) else None for name, value in found.items() if not is_within(value)},
    }


def is_within(boundary: float) -> bool:
    """Return whether an energy across the boundary is within bounds."""
    return BOUNDARY_BOUNDS[0] <= boundary <= BOUNDARY_BOUNDS[1]


def mean(values: list[bool] | list[float]) -> float:
    """Return the mean, or the fraction of true values, with three digits."""
    return round(float(np.mean(values)), 3)


def summarize_gradients(cases: Cases) -> dict[str, Any]:
    """Return what `summarize_quality` does, and the low-band PSNR against the best diffusion and the best patch method of each case."""
    summary = summarize_quality(cases)
    methods = [name for name in next(iter(cases.values())) if name != "truth"]
    summary["mean_low_band_db"] = {name: mean_of(cases, name, "low_band_db") for name in methods}
    if "farfield" not in methods:
        return summary
    for label, peers, bound in (("diffusion", DIFFUSION_PEERS, -MAX_LOW_BAND_LOSS), ("patch", PATCH_PEERS, 0.0)):
        present = [peer for peer in peers if peer in methods]
        if present:
            gains = {name: gain_over(scores, present) for name, scores in cases.items()}
            worst = sorted(gains, key=gains.get)[:5]
            summary[f"gain_over_best_{label}_db"] = {
                "mean": round(float(np.mean(list(gains.values()))), 2),
                "within_bound": mean([gain >= bound for gain in gains.values()]),
                "bound": bound,
                "smallest": {name: gains[name] for name in worst},
                "mean_over_each": {
                    peer: round(float(np.mean([gain_over(scores, [peer]) for scores in cases.values()])), 2) for peer in present
                },
            }
    return summary


def gain_over(scores: dict[str, dict[str, Any]], peers: list[str]) -> float:
    """Return the low-band PSNR of Farfield minus that of the best of `peers`, in dB."""
    best = max(scores[peer].get("low_band_db", 0.0) for peer in peers)
    return round(scores["farfield"].get("low_band_db", 0.0) - best, 2)


def summarize_kappa(cases: Cases) -> dict[str, Any]:
    """Return how often the automatic number of sub-bands is better than, equal to and worse than none and all of them."""
    summary: dict[str, Any] = {}
    for measure, sign in (("distance", 1.0), ("distance_to_truth", 1.0), ("low_band_db", -1.0)):
        summary[measure] = {name: mean_of(cases, name, measure) for name in ("farfield", "kappa-0", "diffusion")}
        for other in ("kappa-0", "diffusion"):
            pairs = [(scores["farfield"].get(measure), scores[other].get(measure)) for scores in cases.values()]
            signs = [np.sign(sign * (first - second)) for first, second in pairs if first is not None and second is not None]
            summary[measure][f"than {other}"] = {name: signs.count(value) for name, value in (("better", -1), ("equal", 0), ("worse", 1))}
    summary["kappas"] = [scores["farfield"].get("kappa") for scores in cases.values()]
    return summary | {"cases": len(cases), "failed": find_failures(cases)}


def mean_of(cases: Cases, method: str, measure: str) -> float | None:
    """Return the mean of a measure over the cases in which the method did not fail."""
    values = [scores[method][measure] for scores in cases.values() if measure in scores[method]]
    return round(float(np.mean(values)), 5) if values else None


def find_failures(cases: Cases) -> dict[str, str]:
    """Return the errors by method and case."""
    return {
        f"{method}: {name}": scores["error"]
        for name, case in cases.items()
        for method, scores in case.items()
        if "error" in scores
    }  # fmt: skip
