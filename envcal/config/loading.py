"""Settings file → settings whose files exist, every path absolute. All mistakes are told at once."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from envcal.config.mistakes import line_of, told
from envcal.config.models import DeclaredLight, Frames, Pipeline, Settings
from envcal.config.reading import override, plain, read_yaml
from envcal.errors import EnvcalError

#: The shot of the reference's view with the lamp off.
LAMP_OFF = "lamp_off"

Model = TypeVar("Model", bound=Settings)


@dataclass(frozen=True, slots=True)
class Loaded:
    """A pipeline file as read: its settings, and the frames of each shot, every path absolute."""

    path: Path
    settings: Pipeline
    output: Path
    reference: tuple[Path, ...]
    environments: Mapping[str, tuple[Path, ...]]
    lamp_off: tuple[Path, ...]
    lights: tuple[DeclaredLight, ...]

    @property
    def folder(self) -> Path:
        """The folder of the file, from which its relative paths start."""
        return self.path.resolve().parent

    @property
    def shots(self) -> dict[str, tuple[Path, ...]]:
        """Shot name → frames, the reference first."""
        pair = {LAMP_OFF: self.lamp_off} if self.lamp_off else {}
        return {"reference": self.reference, **pair, **self.environments}


def schema() -> str:
    """The JSON schema of pipeline.yaml, for editors."""
    return json.dumps(Pipeline.model_json_schema(), indent=1, ensure_ascii=False) + "\n"


def load(path: Path, *, overrides: Sequence[str] = ()) -> Loaded:
    """Read a pipeline file; `overrides` are `key.key=value` with the value in YAML, as `--set` gives them.

    Relative paths in the file start from the file's own folder. Raises an `EnvcalError` listing every mistake.
    """
    tree = read_yaml(path)
    if _is_lights(tree):
        raise EnvcalError(
            f"{path}: is a lights.yaml, and names no photographs; a pipeline.yaml is expected. `envcal cluster` and `envcal "
            f"uplift` take this file with --lights; in a pipeline.yaml its lights stand under `cluster`."
        )
    if tree is None or not isinstance(tree, dict):
        raise EnvcalError(f"{path}: holds no settings; at least `capture: {{reference: shots/*.dng}}` is needed.")
    set_by: dict[tuple[str, ...], str] = {}
    for text in overrides:
        set_by[override(tree, text)] = text
    try:
        settings = Pipeline.model_validate(plain(tree))
    except ValidationError as error:
        raise EnvcalError("\n".join(told(path, tree, error, set_by))) from None
    return _resolve(path, tree, settings)


def stage_settings(model: type[Model], stage: str, overrides: Sequence[str], **given: Any) -> Model:
    """The settings of one stage from `--set key=value` alone; the stage's own name may stand before the key.

    What is in `given` and not None comes from another option. Raises an `EnvcalError` listing every mistake.
    """
    tree: dict[str, Any] = {}
    set_by: dict[tuple[str, ...], str] = {}
    for text in overrides:
        set_by[override(tree, text.strip().removeprefix(f"{stage}."))] = text
    named = {key: value for key, value in given.items() if value is not None}
    twice = sorted(tree.keys() & named.keys())
    if twice:
        raise EnvcalError(f"--set {twice[0]}: is also given as an option of its own; leave one of the two out.")
    try:
        return model.model_validate(tree | named)
    except ValidationError as error:
        raise EnvcalError("\n".join(told(Path("--set"), tree, error, set_by, model=model))) from None


_LIGHTS_FORM = "lights: [{at: [0.84, 0.16], type: led}]"


def _is_lights(tree: Any) -> bool:
    """Whether a tree holds declared lights and nothing of a pipeline."""
    if isinstance(tree, dict):
        return "lights" in tree and "capture" not in tree
    return isinstance(tree, list) and any(isinstance(one, dict) and "at" in one for one in tree)


def load_lights(path: Path, library: Path | None = None) -> tuple[DeclaredLight, ...]:
    """Read a `lights.yaml`: `lights: [...]`, the bare list, or `cluster: {lights: [...]}` as in a pipeline file."""

    class Lights(Settings):
        lights: list[DeclaredLight]

    class InCluster(Settings):
        cluster: Lights

    tree = read_yaml(path, expected="a lights.yaml")
    form = f"A lights.yaml holds `{_LIGHTS_FORM}`, or that list alone; u and v run from the top left of the map"
    if isinstance(tree, dict) and "capture" in tree:
        raise EnvcalError(
            f"{path}: is a pipeline.yaml, which `envcal run` takes; a lights.yaml is expected. Copy the `lights` under its "
            f"`cluster` to a file. {form}."
        )
    if isinstance(tree, list):
        tree = _Headed(lights=tree)
    if not isinstance(tree, dict) or not tree:
        raise EnvcalError(f"{path}: holds no lights. {form}.")
    try:
        if "cluster" in tree:
            lights = InCluster.model_validate(plain(tree)).cluster.lights
        else:
            lights = Lights.model_validate(plain(tree)).lights
    except ValidationError as error:
        model = InCluster if "cluster" in tree else Lights
        raise EnvcalError("\n".join([*told(path, tree, error, {}, model=model), f"{form}."])) from None
    return tuple(_rooted(light, path.parent, library) for light in lights)


class _Headed(dict[str, Any]):
    """A bare list under the key that it goes without, at whose place stands the file's beginning."""

    class _Place:
        def key(self, _key: str) -> tuple[int, int]:
            return 0, 0

    lc = _Place()


def _rooted(light: DeclaredLight, folder: Path, library: Path | None) -> DeclaredLight:
    from envcal.spd import resolved

    if light.spd is None:
        return light
    return light.model_copy(update={"spd": resolved(folder / light.spd, library)})


def _resolve(path: Path, tree: Any, settings: Pipeline) -> Loaded:
    folder = path.resolve().parent
    mistakes: list[str] = []

    def frames(patterns: Frames, where: tuple[str, ...]) -> tuple[Path, ...]:
        found: dict[Path, None] = {}
        for pattern in [patterns] if isinstance(patterns, str) else patterns:
            matches = _matches(folder, pattern)
            if not matches:
                line = line_of(tree, where)
                mistakes.append(
                    f"{path}:{line}: {'.'.join(where)}: no file matches {pattern!r} in {folder}. Correct the pattern; "
                    f"it starts from the folder of the settings file."
                )
            found.update(dict.fromkeys(matches))
        return tuple(found)

    capture = settings.capture
    reference = frames(capture.reference, ("capture", "reference"))
    environments: dict[str, tuple[Path, ...]] = {}
    if isinstance(capture.environment, dict):
        for name, patterns in capture.environment.items():
            if name in ("reference", LAMP_OFF) or not name.replace("_", "").replace("-", "").isalnum():
                line = line_of(tree, ("capture", "environment", name))
                mistakes.append(
                    f"{path}:{line}: capture.environment.{name}: a shot's name is made of letters, "
                    f"digits, - and _, and is not `reference` or `{LAMP_OFF}`; it becomes a file's name."
                )
            environments[name] = frames(patterns, ("capture", "environment", name))
    elif capture.environment is not None:
        environments["environment"] = frames(capture.environment, ("capture", "environment"))
    lamp_off = () if capture.lamp_off is None else frames(capture.lamp_off, ("capture", LAMP_OFF))
    absent = _absent_files(path, tree, settings)
    mistakes += absent.values()
    owned = {
        name: folder / value
        for name in ("library", "sky_model")
        if (value := getattr(settings.cluster, name)) is not None and ("cluster", name) not in absent
    }
    library = owned.get("library")
    settings = settings.model_copy(update={"cluster": settings.cluster.model_copy(update=dict(owned))})
    lights = []
    for number, light in enumerate(settings.cluster.lights):
        rooted = _rooted(light, folder, library)
        if rooted.spd is not None and not rooted.spd.is_file():
            line = line_of(tree, ("cluster", "lights", number, "spd"))
            mistakes.append(
                f"{path}:{line}: cluster.lights.{number}.spd: there is no file {rooted.spd}. Correct the path."
            )
        lights.append(rooted)
    mistakes += _camera_mistakes(path, tree, settings.balance.camera, folder)
    for number, further in enumerate(settings.cluster.profiles):
        if not (folder / further).is_file():
            line = line_of(tree, ("cluster", "profiles", number))
            mistakes.append(
                f"{path}:{line}: cluster.profiles.{number}: there is no file {folder / further}. Correct the path."
            )
    if mistakes:
        raise EnvcalError("\n".join(mistakes))
    return Loaded(path, settings, folder / settings.output, reference, environments, lamp_off, tuple(lights))


def _absent_files(path: Path, tree: Any, settings: Pipeline) -> dict[tuple[str, str], str]:
    """Mistakes for files and folders that the settings name and that do not exist, by the place of the setting."""
    folder, out = path.resolve().parent, {}
    named = (
        ("merge", "dark_frame", settings.merge.dark_frame),
        ("merge", "flat_field", settings.merge.flat_field),
        ("merge", "lens_database", settings.merge.lens_database),
        ("correct", "patches", settings.correct.patches),
        ("balance", "spectrum", settings.balance.spectrum),
        ("cluster", "library", settings.cluster.library),
        ("cluster", "sky_model", settings.cluster.sky_model),
    )
    for stage, key, value in named:
        if value is None:
            continue
        what = "folder" if key == "library" else "file"
        either = key == "lens_database" and (folder / value).is_dir()
        if not ((folder / value).is_dir() if key == "library" else either or (folder / value).is_file()):
            out[stage, key] = (
                f"{path}:{line_of(tree, (stage, key))}: {stage}.{key}: there is no {what} {folder / value}. Correct the path."
            )
    return out


def _camera_mistakes(path: Path, tree: Any, camera: str | None, folder: Path) -> list[str]:
    if camera is None or (folder / camera).is_file():
        return []
    from envcal.cameras import is_known, known_cameras

    if is_known(camera):
        return []
    return [
        f"{path}:{line_of(tree, ('balance', 'camera'))}: balance.camera: {camera!r} is neither a file in {folder} nor a camera known "
        f"by name ({', '.join(known_cameras())}). Correct it, or leave it out."
    ]


def _matches(folder: Path, pattern: str) -> list[Path]:
    """Files that match a pattern, relative to `folder` or absolute, in the order of their names."""
    whole = Path(pattern)
    base = Path(whole.anchor) if whole.is_absolute() else folder
    relative = str(whole.relative_to(whole.anchor)) if whole.is_absolute() else pattern
    if not relative or relative == ".":
        return []
    try:
        return sorted(p for p in base.glob(relative) if p.is_file())
    except (ValueError, NotImplementedError, OSError):
        return []
