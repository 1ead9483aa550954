"""The demo's figures as a page for people."""

from typing import Any


def markdown(heading: str, report: dict[str, Any]) -> str:
    """The report as Markdown, under `heading`; its picture lies beside it."""
    lines = [f"# {heading}", "", "![original above, cloud below](contact-sheet.png)", "", *_levels(report), ""]
    for number, level in enumerate(report["levels"]):
        if "pictures" in level:
            lines += [*_views(number, level["pictures"]), ""]
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in report["seconds"].items())
    lines += [f"Seconds: {stages}. Peak memory: {report['peak_memory_mb']:,.0f} MB.", ""]
    return "\n".join(lines)


def _levels(report: dict[str, Any]) -> list[str]:
    rows = [
        "| level | error (scene units) | quads | texels | from this distance on | mean SSIM | mean silhouette IoU |",
        "|---|---|---|---|---|---|---|",
    ]
    for number, level in enumerate(report["levels"]):
        pictures = level.get("pictures")
        scores = f"{pictures['mean_ssim']:.3f} | {pictures['mean_alpha_iou']:.3f}" if pictures else "not compared | not compared"
        distance = "never" if level["switch_distance"] is None else f"{level['switch_distance']:.4g}"
        rows.append(f"| {number} | {level['error']:.4g} | {level['quads']:,} | {level['texels']:,} | {distance} | {scores} |")
    return rows


def _views(number: int, pictures: dict[str, Any]) -> list[str]:
    rows = [f"Level {number}, view by view ({pictures['setting']}):", "", "| view from | SSIM | silhouette IoU |", "|---|---|---|"]
    for view in pictures["views"]:
        direction = ", ".join(f"{value:.2f}" for value in view["direction"])
        rows.append(f"| {direction} | {view['ssim']:.3f} | {view['alpha_iou']:.3f} |")
    return rows
