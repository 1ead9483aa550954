"""Operators of the tool `btf`: bake relightable textures for a cloud, choose the suns that light it, go back to the plain maps."""

import bpy

from ..bridge import btf_clouds
from ..bridge.btf_materials import SUNS
from ..core.btf.settings import BtfSettings
from . import long_work, properties
from .billboards_clouds import StandingCloud, cloud_for
from .btf_estimates import work_folder
from .btf_job import BtfJob, prepare


def sun_pointer(number: int) -> str:
    """The property of the panel that names sun `number`."""
    return f"sun_{number + 1}"


def _is_sun(_group: bpy.types.PropertyGroup, item: bpy.types.Object) -> bool:
    return item.type == "LIGHT" and item.data.type == "SUN"


class FARFIELD_PG_btf(bpy.types.PropertyGroup):
    """What the panel *Relightable Textures* holds, kept with each scene."""

    __annotations__ = (
        properties.annotations(BtfSettings, set())
        | {
            sun_pointer(number): bpy.props.PointerProperty(
                name=f"Sun {number + 1}", description="A sun lamp that lights the cloud", type=bpy.types.Object, poll=_is_sun
            )
            for number in range(SUNS)
        }
        | {
            "ambient": bpy.props.FloatVectorProperty(
                name="Ambient", description="Colour of even light from everywhere", subtype="COLOR", size=3, min=0.0, soft_max=1.0
            )
        }
    )


class FARFIELD_OT_btf_bake(long_work.LongWork, bpy.types.Operator):
    """Bake textures for the active billboard cloud that change with view and light, with Cycles"""

    bl_idname = "farfield.btf_bake"
    bl_label = "Bake Relightable Textures"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = properties.annotations(BtfSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether a cloud is chosen and nothing else under way."""
        return long_work.allowed(cls, refusal(context))

    def prepare(self, context: bpy.types.Context) -> BtfJob:
        """Read the original of the active cloud. Finished views wait in a temporary folder, so that a stopped bake goes on."""
        properties.fill_unset(BtfSettings, self, context.scene.farfield_btf)
        settings = properties.read(BtfSettings, self)
        return prepare(context, chosen(context), settings, work_folder(chosen(context), settings), keeps_work=False)


class OnBakedCloud:
    """Mixin of operators that need relightable textures."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active cloud has relightable textures."""
        return is_baked(chosen(context))


class FARFIELD_OT_btf_light(OnBakedCloud, bpy.types.Operator):
    """Let the chosen sun lamps and the ambient colour light the active cloud; turning a lamp relights it from then on"""

    bl_idname = "farfield.btf_light"
    bl_label = "Light with Suns"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make the drivers anew."""
        group = context.scene.farfield_btf
        suns = [sun for sun in (getattr(group, sun_pointer(number)) for number in range(SUNS)) if sun is not None]
        for level in chosen(context).levels:
            btf_clouds.light_with(level, suns, group.ambient)
        self.report({"INFO"}, f"Lit by {', '.join(sun.name for sun in suns) or 'the ambient colour alone'}.")
        return {"FINISHED"}


class FARFIELD_OT_btf_plain(OnBakedCloud, bpy.types.Operator):
    """Take the relightable textures off the active cloud: under many lamps or an environment image, the plain maps are right"""

    bl_idname = "farfield.btf_plain"
    bl_label = "Back to Plain Maps"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Put the plain material back."""
        for level in chosen(context).levels:
            btf_clouds.take_off(level)
        return {"FINISHED"}


def chosen(context: bpy.types.Context) -> StandingCloud | None:
    """The cloud that the active object is a level of or was built into."""
    return cloud_for(context.scene, context.active_object)


def is_baked(cloud: StandingCloud | None) -> bool:
    """Whether a cloud wears relightable textures."""
    return cloud is not None and all(btf_clouds.PLAIN_MATERIAL in level for level in cloud.levels)


def refusal(context: bpy.types.Context) -> str:
    """Why nothing can be baked now, or an empty string."""
    return long_work.busy() or ("" if chosen(context) is not None else "Select a billboard cloud or its original")


CLASSES = (FARFIELD_PG_btf, FARFIELD_OT_btf_bake, FARFIELD_OT_btf_light, FARFIELD_OT_btf_plain)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes and hang the settings on scenes."""
    register_classes()
    bpy.types.Scene.farfield_btf = bpy.props.PointerProperty(type=FARFIELD_PG_btf)


def unregister() -> None:
    """The reverse."""
    del bpy.types.Scene.farfield_btf
    unregister_classes()
