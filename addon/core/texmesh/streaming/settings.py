"""Settings of packages."""

from dataclasses import dataclass

from ...settings import Settings, Unit, setting

PACKAGE = "Package"


@dataclass(frozen=True, kw_only=True)
class PackageSettings(Settings):
    """What a package is made for."""

    time_limit: float = setting(
        10.0,
        "Time within which the model is complete. The page can change it",
        minimum=0.5,
        maximum=3600.0,
        unit=Unit.SECONDS,
        group=PACKAGE,
    )
    mirrors: str = setting("", "URLs of folders with copies of the package, separated by commas", group=PACKAGE)
    with_glb: bool = setting(True, "Also write a .glb file with all levels, for other programs", label="glTF File", group=PACKAGE)
