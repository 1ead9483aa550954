"""Pairs of points of a photograph, which are stored with its image: a place on the mesh, and where the photograph shows it."""

import bpy
import numpy as np

from ...core.geometry.lenses import Lens
from ...core.photos.registration.registration import Registration, register

PROPERTY = "farfield_registration"  # the property of images that holds the pairs


class FARFIELD_PG_photo_pair(bpy.types.PropertyGroup):
    """A pair of points; only one of them may be set yet. residual: how far the registered camera projects the point from the position."""

    __annotations__ = {
        "point": bpy.props.FloatVectorProperty(name="Point", description="Place in world space", subtype="TRANSLATION", precision=5),
        "position": bpy.props.FloatVectorProperty(
            name="Position", description="Place in the photograph in pixels from the lower left corner", size=2
        ),
        "has_point": bpy.props.BoolProperty(name="Has Point"),
        "has_position": bpy.props.BoolProperty(name="Has Position"),
        "residual": bpy.props.FloatVectorProperty(name="Residual", description="Distance of the projected point in pixels", size=2),
        "is_wrong": bpy.props.BoolProperty(name="Is Wrong", description="The pair does not fit to the others"),
    }


class FARFIELD_PG_photo_registration(bpy.types.PropertyGroup):
    """The pairs of a photograph and the lens of another one. is_registered: the residuals are those of a camera."""

    __annotations__ = {
        "pairs": bpy.props.CollectionProperty(type=FARFIELD_PG_photo_pair),
        "lens_camera": bpy.props.PointerProperty(
            name="Lens of",
            description="Camera of another photograph that was taken with the same lens and zoom. Without it the lens is found, too",
            type=bpy.types.Object,
            poll=lambda _, item: item.type == "CAMERA",
        ),
        "is_registered": bpy.props.BoolProperty(name="Is Registered"),
    }


def read_pairs(image: bpy.types.Image) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Return the indices (N,) of the complete pairs, their points (N, 3) and their positions (N, 2) in pixels."""
    pairs = getattr(image, PROPERTY).pairs
    indices = [index for index, pair in enumerate(pairs) if pair.has_point and pair.has_position]
    points = np.array([pairs[index].point for index in indices], np.float64).reshape(-1, 3)
    positions = np.array([pairs[index].position for index in indices], np.float64).reshape(-1, 2)
    return indices, points, positions


def register_image(image: bpy.types.Image, lens: Lens | None) -> Registration:
    """Register a photograph by its complete pairs, and store the residuals with them.

    Raises:
        GeometryError: see `register`; nothing is stored.
    """
    indices, points, positions = read_pairs(image)
    found = register(image.name, points, positions, tuple(image.size), lens)
    group = getattr(image, PROPERTY)
    for index, residual, is_wrong in zip(indices, found.residuals, found.is_wrong, strict=True):
        group.pairs[index].residual, group.pairs[index].is_wrong = residual, bool(is_wrong)
    group.is_registered = True
    return found


def add_point(image: bpy.types.Image, point: np.ndarray) -> None:
    """Set the point (3,) of the last pair, or of a new one if the last has a point."""
    pair = _open_pair(image, "has_point")
    pair.point, pair.has_point = point, True


def add_position(image: bpy.types.Image, position: np.ndarray) -> None:
    """Set the position (2,) of the last pair in pixels, or of a new one if the last has a position."""
    pair = _open_pair(image, "has_position")
    pair.position, pair.has_position = position, True


def remove_pair(image: bpy.types.Image, index: int) -> None:
    """Remove a pair; the residuals of the others become invalid."""
    group = getattr(image, PROPERTY)
    group.pairs.remove(index)
    group.is_registered = False


def remove_incomplete(image: bpy.types.Image) -> None:
    """Remove pairs of which only one point is set."""
    pairs = getattr(image, PROPERTY).pairs
    for index in reversed(range(len(pairs))):
        if not (pairs[index].has_point and pairs[index].has_position):
            pairs.remove(index)


def copy_pairs(image: bpy.types.Image) -> list[dict[str, object]]:
    """Return the values of all pairs, for `restore_pairs`."""
    names = FARFIELD_PG_photo_pair.__annotations__
    return [
        {name: value if isinstance(value := getattr(pair, name), bool) else tuple(value) for name in names}
        for pair in getattr(image, PROPERTY).pairs
    ]


def restore_pairs(image: bpy.types.Image, copies: list[dict[str, object]], *, is_registered: bool) -> None:
    """Replace all pairs by copies."""
    group = getattr(image, PROPERTY)
    group.pairs.clear()
    for values in copies:
        pair = group.pairs.add()
        for name, value in values.items():
            setattr(pair, name, value)
    group.is_registered = is_registered


def _open_pair(image: bpy.types.Image, name: str) -> FARFIELD_PG_photo_pair:
    """Return the last pair if its property `name` is not set, otherwise a new pair."""
    group = getattr(image, PROPERTY)
    group.is_registered = False
    if len(group.pairs) and not getattr(group.pairs[-1], name):
        return group.pairs[-1]
    return group.pairs.add()


CLASSES = (FARFIELD_PG_photo_pair, FARFIELD_PG_photo_registration)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def add_properties() -> None:
    """Register the classes and give images their pairs."""
    register_classes()
    setattr(bpy.types.Image, PROPERTY, bpy.props.PointerProperty(type=FARFIELD_PG_photo_registration))


def remove_properties() -> None:
    """Remove the pairs from images and unregister the classes."""
    delattr(bpy.types.Image, PROPERTY)
    unregister_classes()
