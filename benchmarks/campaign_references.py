"""Reference readers for `campaign_files.py`: values of elevation models, images and cameras by other programs.

`PYTHON benchmarks/campaign_references.py` answers requests, one JSON object per line, in an environment of its own. It may have rasterio,
tifffile with imagecodecs, Pillow, OpenEXR and pycolmap. A request names what Farfield read, in .npy files; the answer counts differences.
It imports nothing of Farfield.
"""

import json
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

FEET = {"ft": 0.3048, "feet": 0.3048, "foot": 0.3048, "us survey foot": 1200 / 3937, "us-ft": 1200 / 3937}
SENSITIVITY = 1e-5  # Rounding of float32, relative to the largest height.
ALPHA_IMAGES = (".tif", ".tiff")  # in which heights are unknown where alpha is 0
NEAR_SIDES = 4  # Projections that lie this many sides of the photograph away count; rounding grows with the distance.
JPEG_STEPS = 3  # Difference of 255 between the decoders of two programs.


def compare_heights(request: dict[str, Any]) -> dict[str, Any]:
    """Compare heights (H, W), row 0 in the south, NaN where unknown, and the spacing of the grid with what GDAL reads."""
    import rasterio

    found = np.load(request["heights"])
    with rasterio.open(request["path"]) as file:
        band = file.read(1).astype(np.float64)
        known = (file.dataset_mask() > 0) & (file.read_masks(1) > 0) & np.isfinite(band)
        unit = FEET.get((file.units[0] or "").lower(), 1.0)
        expected = np.where(known, (band * file.scales[0] + file.offsets[0]) * unit, np.nan)
        if request["white"] is not None:
            has_alpha = Path(request["path"]).suffix.lower() in ALPHA_IMAGES
            expected = np.where(known | (not has_alpha), request["white"] * _read_gray(file), np.nan)
        elif file.count >= 3:
            expected = np.where(known, file.read((1, 2, 3)).mean(axis=0), np.nan)
        if file.transform.e < 0 or file.transform.is_identity:
            expected = expected[::-1]
        step = [abs(file.transform.a), abs(file.transform.e)]
        if file.crs is not None and file.crs.is_projected:
            step = [value * file.crs.linear_units_factor[1] for value in step]
        answer = {"reader": f"GDAL {rasterio.__gdal_version__}", "bands": file.count, "type": file.dtypes[0], "step": step}
    if found.shape != expected.shape:
        return answer | {"problem": f"shape {found.shape} instead of {expected.shape}"}
    unknown, missing = np.isnan(found) & ~np.isnan(expected), np.isnan(expected) & ~np.isnan(found)
    both = ~np.isnan(found) & ~np.isnan(expected)
    tolerance = SENSITIVITY * max(1.0, float(np.abs(expected[both]).max(initial=0.0)))
    differing = both & (np.abs(found - expected) > tolerance)
    answer |= {"samples": found.size, "only_unknown_here": int(unknown.sum()), "only_known_here": int(missing.sum())}
    answer |= {"differing": int(differing.sum())}
    if unknown.any():
        answer["unknown_values"] = [float(value) for value in np.unique(expected[unknown])[:5]]
    if missing.any():
        answer["known_values"] = [float(value) for value in np.unique(found[missing])[:5]]
    if differing.any():
        index = tuple(np.argwhere(differing)[0])
        answer["example"] = [float(found[index]), float(expected[index])]
    if request["step"] is not None and not np.allclose(request["step"], step, rtol=1e-6):
        answer["problem"] = f"steps {request['step']} instead of {step}"
    if unknown.any() or missing.any() or differing.any():
        answer["problem"] = f"{int(differing.sum())} heights and {int((unknown | missing).sum())} holes differ"
    return answer


def _read_gray(file: Any) -> np.ndarray:
    """Return the mean (H, W) of the colors of an image, 1 for white."""
    if file.colorinterp[0].name == "palette":
        table = np.array([file.colormap(1)[index][:3] for index in range(len(file.colormap(1)))])
        return table[file.read(1)].mean(axis=-1) / 255
    bits = int(file.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", 8 * np.dtype(file.dtypes[0]).itemsize))
    return file.read(range(1, 4) if file.count >= 3 else [1]).mean(axis=0) / (2**bits - 1)


def compare_images(request: dict[str, Any]) -> dict[str, Any]:
    """Compare the pixels of two files outside of a mask (H, W), row 0 at the top."""
    mask = np.load(request["mask"])
    images = []
    for name in ("path", "out"):
        pixels, reader = _read_image(Path(request[name]))
        images.append(pixels)
    answer = {"reader": reader, "shape": list(images[0].shape), "type": str(images[0].dtype)}
    before, after = (_expand(_normalized(pixels)) for pixels in images)
    if before.shape[2] == 1 and after.shape[2] == 3:
        before = before.repeat(3, axis=2)
    if before.shape != after.shape or before.shape[:2] != mask.shape:
        return answer | {"problem": f"shape {after.shape} instead of {before.shape}"}
    differences = np.abs(before - after)[~mask]
    differences = differences[np.isfinite(differences)]
    is_jpeg = Path(request["out"]).suffix.lower() in (".jpg", ".jpeg")
    answer["largest"] = float(differences.max(initial=0.0))
    answer["mean"] = float(differences.mean()) if differences.size else 0.0
    if answer["mean"] > JPEG_STEPS / 255 if is_jpeg else answer["largest"] > 0:
        answer["problem"] = f"pixels outside of the mask differ by {answer['largest']:.4g}, {answer['mean']:.4g} on average"
    return answer


def _read_image(path: Path) -> tuple[np.ndarray, str]:
    """Return the pixels of an image as they are stored, (H, W) or (H, W, C), and the name of the reader."""
    start = path.read_bytes()[:8]
    if start.startswith((b"II", b"MM")):
        import tifffile

        return _read_tiff(path), f"tifffile {tifffile.__version__}"
    if start.startswith(b"v/1\x01"):
        import OpenEXR

        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        names = sorted(channels, key=lambda name: "RGBA".find(name[-1]) if name[-1] in "RGBA" else 9)
        return np.stack([channels[name].pixels for name in names], axis=-1), f"OpenEXR {OpenEXR.__version__}"
    import imagecodecs

    decode = imagecodecs.png_decode if start.startswith(b"\x89PNG") else imagecodecs.jpeg8_decode
    return decode(path.read_bytes()), f"imagecodecs {imagecodecs.__version__}"


def _read_tiff(path: Path) -> np.ndarray:
    import tifffile

    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        if page.bitspersample == 1:
            from PIL import Image

            image = Image.open(path)
            return np.array(image.convert("RGB" if image.mode == "P" else "L"))
        pixels = page.asarray()
        if page.photometric == tifffile.PHOTOMETRIC.PALETTE:
            return np.moveaxis(page.colormap[:, pixels] // 257, 0, -1).astype(np.uint8)
        if page.planarconfig == tifffile.PLANARCONFIG.SEPARATE and pixels.ndim == 3:
            pixels = np.moveaxis(pixels, 0, -1)
        if page.bitspersample in (2, 4):
            pixels = (pixels.astype(np.uint32) * 255 // (2**page.bitspersample - 1)).astype(np.uint8)
        if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
            pixels = np.iinfo(pixels.dtype).max - pixels
        return pixels


def _normalized(pixels: np.ndarray) -> np.ndarray:
    """Return pixels as double precision, integers and booleans from 0 to 1."""
    if pixels.dtype.kind == "b":
        return pixels.astype(float)
    return pixels / np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else pixels.astype(float)


def _expand(pixels: np.ndarray) -> np.ndarray:
    return pixels[..., None] if pixels.ndim == 2 else pixels


def compare_cameras(request: dict[str, Any]) -> dict[str, Any]:
    """Compare projections of points by the cameras of a COLMAP model; positions from the lower left corner of photographs."""
    import pycolmap

    model = pycolmap.Reconstruction(request["path"])
    found, points = np.load(request["projections"]), np.load(request["points"])
    names = {image.name.replace("\\", "/"): image for image in model.images.values()}
    answer = {"reader": f"COLMAP {pycolmap.__version__}", "cameras": len(request["names"]), "largest": 0.0}
    if len(names) != len(request["names"]):
        answer["problem"] = f"{len(request['names'])} cameras instead of {len(names)}"
    for index, name in enumerate(request["names"]):
        image = names[name]
        expected = [image.project_point(point) for point in points]
        size = model.cameras[image.camera_id].height
        near = NEAR_SIDES * max(model.cameras[image.camera_id].width, size)
        pairs = [(a, b) for a, b in zip(found[index], expected, strict=True) if b is not None and np.abs(a).max() < near]
        differences = [np.abs(a - [b[0], size - b[1]]).max() for a, b in pairs]
        answer["largest"] = max([answer["largest"], *map(float, differences)])
    if answer["largest"] > 1e-3:
        answer["problem"] = f"projections differ by {answer['largest']:.3g} pixels"
    return answer


COMPARISONS = {"heights": compare_heights, "image": compare_images, "cameras": compare_cameras}


def main() -> None:
    """Answer requests until the standard input ends."""
    warnings.simplefilter("ignore")
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = COMPARISONS[request["kind"]](request)
        except Exception as error:  # noqa: BLE001 other programs' readers raise anything for files that they do not read
            answer = {"no_reference": f"{type(error).__name__}: {error}"[:300]}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
