"""The demo's report as a Markdown page."""

from typing import Any


def to_markdown(heading: str, report: dict[str, Any]) -> str:
    """Return the report as Markdown with the title `heading`; its images are in the same folder."""
    lines = [f"# {heading}", "", "![source above, cloud below](contact-sheet.png)", "", *_levels(report), ""]
    for index, level in enumerate(report["levels"]):
        if "comparison" in level:
            lines += [*_views(index, level["comparison"]), ""]
    if "relighting" in report:
        lines += [*_relighting(report["relighting"]), "", *_forest(report["forest"]), ""]
    if "photos" in report:
        lines += [*_photos(report["photos"]), ""]
    if "terrain" in report:
        lines += [*_terrain(report["terrain"]), ""]
    if "texmesh" in report:
        lines += [*_perceptual_levels(report["texmesh"]), ""]
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in report["seconds"].items())
    lines += [f"Seconds: {stages}. Peak memory: {report['peak_memory_mb']:,.0f} MB.", ""]
    return "\n".join(lines)


def _levels(report: dict[str, Any]) -> list[str]:
    rows = [
        "| level | error (scene units) | quads | texels | switch distance | mean SSIM | mean silhouette IoU |",
        "|---|---|---|---|---|---|---|",
    ]
    for index, level in enumerate(report["levels"]):
        comparison = level.get("comparison")
        scores = f"{comparison['mean_ssim']:.3f} | {comparison['mean_alpha_iou']:.3f}" if comparison else "not compared | not compared"
        distance = "never" if level["switch_distance"] is None else f"{level['switch_distance']:.4g}"
        rows.append(f"| {index} | {level['error']:.4g} | {level['quads']:,} | {level['texels']:,} | {distance} | {scores} |")
    return rows


def _views(index: int, comparison: dict[str, Any]) -> list[str]:
    rows = [f"Level {index}, view by view ({comparison['render_setup']}):", "", "| view from | SSIM | silhouette IoU |", "|---|---|---|"]
    for view in comparison["views"]:
        direction = ", ".join(f"{value:.2f}" for value in view["direction"])
        rows.append(f"| {direction} | {view['ssim']:.3f} | {view['alpha_iou']:.3f} |")
    return rows


def _relighting(report: dict[str, Any]) -> list[str]:
    hemisphere = "above the horizon" if report["upper_hemisphere"] else "in all directions"
    summary = (
        f"Level {report['level']} with silhouettes baked for {report['views']} views {hemisphere}: {report['renders']:,} renders, "
        f"{report['bare_render_seconds']:.1f} s in Cycles. {report['compressed_bytes'] / 1e6:,.2f} MB in addition to the PBR maps."
    )
    rows = [
        "## Relightable",
        "",
        "![source, relightable cloud and others](relighting.png)",
        "",
        summary,
        "",
        f"Mean of {report['pairs']} held-out pairs of view and Sun direction; the impostor has as many bytes as the relightable cloud:",
        "",
        "| | PSNR | SSIM | silhouette IoU |",
        "|---|---|---|---|",
    ]
    for name, scores in report["scores"].items():
        rows.append(f"| {name} | {scores['psnr']:.1f} | {scores['ssim']:.3f} | {scores['alpha_iou']:.3f} |")
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in report["seconds"].items())
    return [*rows, "", f"Seconds: {stages}."]


def _forest(report: dict[str, Any]) -> list[str]:
    hours = f"{report['hours'][0]} to {report['hours'][-1]}"
    summary = f"{report['trees']:,} instances in forest.blend, animated from {hours}; rendered without Farfield."
    return ["![a forest](forest.png)", "", summary]


def _photos(report: dict[str, Any]) -> list[str]:
    rows = ["## Photo texture", "", "![photographs, truth and merged texture](photos.png)", "", report["message"], ""]
    rows += ["| view without a camera | PSNR | SSIM |", "|---|---|---|"]
    rows += [f"| {index + 1} | {view['psnr']:.1f} dB | {view['ssim']:.3f} |" for index, view in enumerate(report["views"])]
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in report["seconds"].items())
    return [*rows, "", f"Seconds: {stages}."]


def _terrain(report: dict[str, Any]) -> list[str]:
    triangles = f"{min(report['triangles']):,} to {max(report['triangles']):,}"
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in report["seconds"].items())
    summary = (
        f"{report['samples']:,} samples, {report['bytes_per_sample']} bytes each; {triangles} triangles in a frame. Seconds: {stages}."
    )
    return ["## Large terrain", "", "![a flight over a terrain](terrain.png)", "", summary]


def _perceptual_levels(report: dict[str, Any]) -> list[str]:
    rows = ["## Perceptual levels", "", "![original and levels where they switch](texmesh.png)", ""]
    rows += [f"Levels of {report['triangles']:,} triangles, and FLIP between each and the finer one where they switch:", ""]
    rows += ["| triangles | pixels | difference |", "|---|---|---|"]
    rows += [f"| {level['triangles']:,} | {level['pixels']} | {level['difference']:.3f} |" for level in report["levels"]]
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in report["seconds"].items())
    return [*rows, "", f"Seconds: {stages}."]
