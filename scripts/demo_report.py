"""The demo's figures as a page for people."""

from typing import Any


def markdown(heading: str, report: dict[str, Any]) -> str:
    """The report as Markdown, under `heading`; its picture lies beside it."""
    lines = [f"# {heading}", "", "![original above, cloud below](contact-sheet.png)", "", *_levels(report), ""]
    for number, level in enumerate(report["levels"]):
        if "pictures" in level:
            lines += [*_views(number, level["pictures"]), ""]
    if "relighting" in report:
        lines += [*_relighting(report["relighting"]), "", *_forest(report["forest"]), ""]
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


def _relighting(figures: dict[str, Any]) -> list[str]:
    where = "above the horizon" if figures["upper_hemisphere"] else "all around"
    ratio = figures["raw_bytes"] / figures["compressed_bytes"]
    baked = (
        f"Level {figures['level']} with textures baked from {figures['views']} views under {figures['lights']} lights and a dome, "
        f"{where}: {figures['renders']:,} renders of {figures['samples']} samples, {figures['bare_render_seconds']:.1f} s in Cycles. "
        f"{figures['raw_bytes'] / 1e6:,.1f} MB became {figures['compressed_bytes'] / 1e6:,.2f} MB, {ratio:,.0f} to 1; "
        f"{figures['fit']['components']} components, {figures['fit']['psnr']:.1f} dB with the noise of the renders counted as error."
    )
    rows = [
        "## Relightable",
        "",
        "![original, relightable cloud and others](relighting.png)",
        "",
        baked,
        "",
        f"Mean of {figures['pairs']} held-out pairs of view and sun; the impostor has as many bytes as the relightable textures:",
        "",
        "| | PSNR | SSIM | silhouette IoU |",
        "|---|---|---|---|",
    ]
    for name, scores in figures["scores"].items():
        rows.append(f"| {name} | {scores['psnr']:.1f} | {scores['ssim']:.3f} | {scores['alpha_iou']:.3f} |")
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in figures["seconds"].items())
    return [*rows, "", f"Seconds: {stages}."]


def _forest(figures: dict[str, Any]) -> list[str]:
    hours = f"{figures['hours'][0]} to {figures['hours'][-1]}"
    planted = f"{figures['trees']:,} instances in forest.blend, where the day passes from {hours}; rendered without Farfield."
    return ["![a forest](forest.png)", "", planted]
