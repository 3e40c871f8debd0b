"""The emitter `envcal` for Mitsuba 3: an uplift file as environment map, evaluated spectrally.

    import mitsuba as mi, envcal.mitsuba
    mi.set_variant("llvm_ad_spectral")
    emitter = mi.load_dict({"type": "envcal", "filename": "uplift.exr"})

Importing this module names a usable LLVM to Mitsuba, and registers the emitter for the variant that is set and for
each that is set later. Import it before the first `llvm_*` variant is set, then a good LLVM is found even where
a bad one would be found first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from envcal.errors import EnvcalError
from envcal.mitsuba import llvm

if TYPE_CHECKING:
    from envcal.mitsuba.loading import Float32, SpectralMap


class MitsubaMissingError(EnvcalError, ImportError):
    """Mitsuba is not installed, or does not load."""


llvm.provide()
try:
    import mitsuba as _mi
except ImportError as _error:
    raise MitsubaMissingError(
        f"Mitsuba 3 cannot be imported ({_error}). Install it with `pip install 'envcal[mitsuba]'`."
    ) from _error

PLUGIN = "envcal"
_classes: dict[str, type[Any]] = {}


def register(variant: str | None = None) -> None:
    """Register the emitter for the current variant, or for `variant` once it is set.

    Called by the import and whenever a variant is set; calling it again does no harm.
    """
    name = variant or _mi.variant()
    if name is None or name in _classes:
        return
    if name.startswith("llvm"):
        import drjit

        llvm.check_loaded(drjit.detail.llvm_version())
    from envcal.mitsuba.emitter import emitter_class

    made = emitter_class(name)
    _mi.register_emitter(PLUGIN, made)
    _classes[name] = made


def set_variant(*names: str) -> None:
    """Set the first Mitsuba variant of `names` that can be had, as `mi.set_variant`; refuse an unusable LLVM first.

    Raises
    ------
    EnvcalError
        None is available, or LLVM is missing or would abort the process.
    """
    if any(name.startswith("llvm") for name in names):
        llvm.check_named()
    try:
        _mi.set_variant(*names)
    except ImportError as error:
        if any(name.startswith("llvm") for name in names) and "LLVM" in str(error):
            raise llvm.missing() from error
        raise EnvcalError(
            f"Mitsuba has no variant {' or '.join(names)}; it has {', '.join(_mi.variants())}."
        ) from error
    register()


def emitter_from(
    spectral: SpectralMap | None = None,
    *,
    to_world: Any = None,
    scale: float = 1.0,
    rgb: Float32 | None = None,
    **properties: Any,
) -> Any:
    """Return an emitter of the current variant that shines with `spectral`; no file is needed.

    `rgb` is the same map in linear sRGB [height, width, 3], needed in the RGB and mono variants only. The other
    arguments are the properties that the plugin has.
    """
    register()
    variant = _mi.variant()
    if variant is None:
        raise EnvcalError("no Mitsuba variant is set; call mitsuba.set_variant('llvm_ad_spectral') first.")
    made = _mi.Properties(PLUGIN)
    for key, value in {"to_world": to_world, "scale": scale, **properties}.items():
        if value is not None:
            made[key] = value
    return _classes[variant](made, spectral=spectral, rgb=rgb)


_mi.detail.add_variant_callback(lambda _old, new: register(new))
register()
