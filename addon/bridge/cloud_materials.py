"""The material of a cloud: ordinary nodes, so that it renders the same where Farfield is not installed."""

import itertools

import bpy

from ..compat import give_nodes
from .node_groups import shared_group
from .wiring import Operand, Wiring

GROUP_NAME = "Farfield Cloud"
GROUP_VERSION = 1
JOINED_ATTRIBUTE = "farfield_joined"  # of faces: 1 where the quad shows a piece of a surface that goes on on others
SOLID_ATTRIBUTE = "farfield_solid"  # of faces: 1 where a camera cannot see the back, since it is the inside of a solid
MAPS = ("Colour", "Normal", "Surface")
SIDES = ("Front", "Back")
FRONT_COLOUR = "Front colour"  # label of the node whose image holds colour and alpha of the fronts
FRONT_NORMAL = "Front normal"  # the same for their normals in the object's frame, as colours
FRONT_SURFACE = "Front surface"  # the same for roughness, metallic and depth


def cloud_material(name: str, images: dict[tuple[str, str], bpy.types.Image], shadowless: float) -> bpy.types.Material:
    """A material that shows `images`, keyed by side ("Front", "Back") and map ("Colour", "Normal", "Surface").

    shadowless: the length within which it stops no light, in the unit of the cloud's objects.
    """
    material = bpy.data.materials.new(name)
    set_two_sided(material)
    give_nodes(material)
    tree = material.node_tree
    tree.nodes.clear()
    wiring = Wiring(tree)
    group = wiring.node("ShaderNodeGroup", {"node_tree": _group(), "width": 220.0})
    group.inputs["Shadowless"].default_value = shadowless
    output = wiring.node("ShaderNodeOutputMaterial")
    wiring.connect(group.outputs["BSDF"], output.inputs["Surface"])
    for side, map_name in itertools.product(SIDES, MAPS):
        settings = {"image": images[side, map_name], "extension": "EXTEND", "label": f"{side} {map_name.lower()}"}
        texture = wiring.node("ShaderNodeTexImage", settings)
        wiring.connect(texture.outputs["Color"], group.inputs[f"{side} {map_name}"])
        if map_name == "Colour":
            wiring.connect(texture.outputs["Alpha"], group.inputs[f"{side} Alpha"])
    wiring.arrange()
    return material


def grey_material(name: str) -> bpy.types.Material:
    """Blender's grey, for clouds without textures."""
    material = bpy.data.materials.new(name)
    set_two_sided(material)
    return material


def set_two_sided(material: bpy.types.Material) -> None:
    """Two-sided, and transparent by dithering: blended surfaces are sorted by object only, so stacked quads would come out wrong."""
    material.surface_render_method = "DITHERED"
    material.use_transparent_shadow = True
    material.use_backface_culling = material.use_backface_culling_shadow = False
    # A quad's normal map leans far from its plane on purpose; the correction for bumps would darken it.
    material.cycles.use_bump_map_correction = False


def _group() -> bpy.types.NodeTree:
    """The node group of all clouds in the file."""
    of_side = (("Colour", "Color"), ("Alpha", "Float"), ("Normal", "Color"), ("Surface", "Color"))
    inputs = [(f"{side} {name}", kind) for side in SIDES for name, kind in of_side]
    return shared_group(GROUP_NAME, GROUP_VERSION, [*inputs, ("Shadowless", "Float")], [("BSDF", "Shader")], _fill)


def _fill(wiring: Wiring) -> None:
    """Pick the side that is seen, and shade it."""
    inputs = wiring.node("NodeGroupInput").outputs
    seen_from_behind = wiring.node("ShaderNodeNewGeometry").outputs["Backfacing"]

    def seen(name: str) -> Operand:
        return wiring.mix(seen_from_behind, inputs[f"Front {name}"], inputs[f"Back {name}"])

    roughness, metallic, _ = wiring.separate(seen("Surface"))
    decoded = wiring.vector("SUBTRACT", wiring.vector("SCALE", seen("Normal"), 2.0), (1.0, 1.0, 1.0))
    shader = wiring.node("ShaderNodeBsdfPrincipled")
    wiring.connect(seen("Colour"), shader.inputs["Base Color"])
    wiring.connect(roughness, shader.inputs["Roughness"])
    wiring.connect(metallic, shader.inputs["Metallic"])
    alpha = wiring.separate(seen("Alpha"))[0]
    lit = wiring.math("MULTIPLY", alpha, _stops_light(wiring, inputs["Shadowless"]))
    wiring.connect(wiring.math("MULTIPLY", lit, _is_seen(wiring, seen_from_behind)), shader.inputs["Alpha"])
    wiring.connect(wiring.turned(decoded, "NORMAL", "OBJECT", "WORLD"), shader.inputs["Normal"])
    wiring.connect(shader.outputs[0], wiring.node("NodeGroupOutput").inputs["BSDF"])


def _stops_light(wiring: Wiring, shadowless: Operand) -> Operand:
    """0 for a ray of light that comes from nearer than `shadowless`, else 1: quads of one surface must not darken each
    other, while leaves do.

    Cycles only; EEVEE knows camera and shadow rays alone, and the length of the latter is that to the lamp.
    """
    path = wiring.node("ShaderNodeLightPath")
    reach = wiring.vector("LENGTH", wiring.turned(wiring.combine(shadowless, 0.0, 0.0), "VECTOR", "OBJECT", "WORLD"))
    near = wiring.math("LESS_THAN", path.outputs["Ray Length"], reach)
    not_seen = wiring.math("SUBTRACT", 1.0, path.outputs["Is Camera Ray"])
    of_light = wiring.math("MULTIPLY", not_seen, wiring.attribute(JOINED_ATTRIBUTE, number=True))
    return wiring.math("SUBTRACT", 1.0, wiring.math("MULTIPLY", of_light, near))


def _is_seen(wiring: Wiring, seen_from_behind: Operand) -> Operand:
    """0 for a camera ray that meets the inside of a solid: only past the outline, where a quad sticks out by its error; else 1."""
    camera = wiring.node("ShaderNodeLightPath").outputs["Is Camera Ray"]
    inside = wiring.math("MULTIPLY", seen_from_behind, wiring.attribute(SOLID_ATTRIBUTE, number=True))
    return wiring.math("SUBTRACT", 1.0, wiring.math("MULTIPLY", inside, camera))
