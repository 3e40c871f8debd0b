"""pipeline.yaml → frozen settings. Every mistake is reported at once, with file and line."""

from envcal.config.loading import Loaded, load, load_lights, schema, stage_settings
from envcal.config.models import (
    BalanceSettings,
    CaptureSettings,
    ClusterSettings,
    CorrectSettings,
    DeclaredLight,
    LampForm,
    LampOnChart,
    LampRectangle,
    MergeSettings,
    PanoramaSettings,
    PhotometrySettings,
    Pipeline,
    Settings,
    SpectraSettings,
    UpliftSettings,
    WorkingSpace,
)
from envcal.config.reading import MOST_BYTES
from envcal.config.texts import LIGHT_TYPES, parse_bands, parse_wavelengths

__all__ = [
    "LIGHT_TYPES",
    "MOST_BYTES",
    "BalanceSettings",
    "CaptureSettings",
    "ClusterSettings",
    "CorrectSettings",
    "DeclaredLight",
    "LampForm",
    "LampOnChart",
    "LampRectangle",
    "Loaded",
    "MergeSettings",
    "PanoramaSettings",
    "PhotometrySettings",
    "Pipeline",
    "Settings",
    "SpectraSettings",
    "UpliftSettings",
    "WorkingSpace",
    "load",
    "load_lights",
    "parse_bands",
    "parse_wavelengths",
    "schema",
    "stage_settings",
]
