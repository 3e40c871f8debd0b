"""pipeline.yaml: every mistake at once, each with its line and a remedy."""

import json
from pathlib import Path

import pytest

from envcal import config
from envcal.errors import EnvcalError

ROOT = Path(__file__).parents[2]


def load(tmp_path, text, **kwargs):
    (tmp_path / "f1.dng").touch()
    (tmp_path / "f2.dng").touch()
    path = tmp_path / "pipeline.yaml"
    path.write_text(text, encoding="utf-8")
    return config.load(path, **kwargs)


def mistakes(tmp_path, text, **kwargs):
    with pytest.raises(EnvcalError) as caught:
        load(tmp_path, text, **kwargs)
    return str(caught.value).replace(str(tmp_path), "").splitlines()


def test_paths_start_from_the_folder_of_the_file_and_frames_are_in_order(tmp_path):
    loaded = load(tmp_path, 'capture: {reference: "*.dng"}\noutput: out\n')
    assert [p.name for p in loaded.reference] == ["f1.dng", "f2.dng"]
    assert loaded.output == tmp_path / "out"
    assert list(loaded.shots) == ["reference"]


def test_an_environment_may_be_one_pattern_or_several_named_shots(tmp_path):
    one = load(tmp_path, 'capture: {reference: "f1.dng", environment: "f2.dng"}\n')
    assert list(one.shots) == ["reference", "environment"]
    two = load(tmp_path, 'capture: {reference: "f1.dng", environment: {north: "f2.dng", south: "f1.dng"}}\n')
    assert list(two.shots) == ["reference", "north", "south"]


def test_every_mistake_is_told_at_once_with_its_line(tmp_path):
    lines = mistakes(
        tmp_path,
        "capture:\n  reference: '*.dng'\noutptu: x\nmerge: {gain_e_per_dn: -1}\ncorrect:\n  fit: linaer\n"
        "balance:\n  lamp: {rectangel: [1, 2, 3, 4]}\ncluster:\n  lights:\n    - {at: [0.5, 1.5], type: ledd}\n",
    )
    assert [line.split(": ")[0] for line in lines] == [
        "/pipeline.yaml:3",
        "/pipeline.yaml:4",
        "/pipeline.yaml:6",
        "/pipeline.yaml:8",
        "/pipeline.yaml:11",
        "/pipeline.yaml:11",
    ]
    assert "did you mean `output`?" in lines[0]
    assert "greater than 0" in lines[1]
    assert "did you mean 'linear'?" in lines[2]
    assert "did you mean `rectangle`?" in lines[3]
    assert "less than or equal to 1" in lines[4]
    assert "did you mean 'led'?" in lines[5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no settings"),
        ("- a\n- b\n", "holds no settings"),
        ("capture: {reference: a.dng}\ncapture: {reference: b.dng}\n", ":2: is not YAML: found duplicate key"),
        ("capture: {reference: [\n", "is not YAML"),
        (
            "capture:\n\treference: a\n",
            ":2: is not YAML: found character '\\t' that cannot start any token. Indent with",
        ),
        (
            "capture:\n  reference: a\n   output: b\n",
            ":3: is not YAML: mapping values are not allowed here. Is this line",
        ),
        ("capture:\n  reference: a\n output: b\n", "indented by one space too many or too few?"),
        ("capture:\n  reference: a\noutput\nmerge:\n  a: 1\n", "with a space after the colon"),
        ("capture:\n  reference: [a\n", "A bracket is opened and not closed"),
        ('output: "a\n', "A quote is opened and not closed"),
        ("capture: {reference: '*.nef'}\n", ":1: capture.reference: no file matches '*.nef'"),
        ("merge: {}\n", "capture: is missing"),
        ("capture: {reference: f1.dng, environment: {reference: f2.dng}}\n", "is not `reference`"),
        ("capture: {reference: f1.dng, environment: {../x: f2.dng}}\n", "letters, digits"),
        ("capture: {reference: f1.dng}\nspectra: {wavelengths: 300:780:10}\n", ":2: spectra.wavelengths: '300:780:10'"),
        ("capture: {reference: f1.dng}\nspectra: {wavelengths: 360:780:10}\n", "leaves the grid 380:780:5"),
        ("capture: {reference: f1.dng}\nspectra: {wavelengths: 380:780:7}\n", "do not end on 780 nm"),
        (
            "capture: {reference: f1.dng}\ncorrect: {chart: [[1, 2], [3, 4]]}\n",
            ":2: correct.chart: is [[1, 2], [3, 4]]",
        ),
        ("capture: {reference: f1.dng}\nuplift: {brightness: .inf}\n", ":2: uplift.brightness"),
        ("capture: {reference: f1.dng}\ncluster: {lights: [{at: [0, 0], spd: no.csv}]}\n", "there is no file"),
        ("capture: {reference: f1.dng}\ncluster: {lights: [{at: [0, 0]}]}\n", "says nothing of the light"),
        ("capture: {reference: f1.dng}\ncluster: {lights: [{at: [0, 0], spd: a.csv, cct: 4000}]}\n", "not both"),
        ("capture: {reference: f1.dng}\nbalance: {lamp: {}}\n", "says nothing of the lamp: give `size` or `within`"),
        ("capture: {reference: f1.dng}\nbalance: {lamp: {size: [12, 110]}}\n", ":2: balance.lamp.size"),
        ("capture: {reference: f1.dng}\nbalance: {lamp: {sze: [0.1, 0.2]}}\n", "did you mean `size`?"),
        ("capture: !!python/object/apply:os.system ['true']\n", "capture"),
    ],
)
def test_a_mistake_is_refused_with_place_and_remedy(tmp_path, text, message):
    assert message in "\n".join(mistakes(tmp_path, text))


def test_tungsten_is_understood_and_its_name_here_told(tmp_path):
    text = "capture: {reference: f1.dng}\ncluster: {lights: [{at: [0, 0], type: tungsten}]}\n"
    assert "did you mean 'incandescent'?" in mistakes(tmp_path, text)[0]


def test_a_missing_or_unreadable_settings_file_is_named(tmp_path):
    with pytest.raises(EnvcalError, match="cannot be read"):
        config.load(tmp_path / "none.yaml")
    (tmp_path / "big.yaml").write_bytes(b"#" * (config.MOST_BYTES + 1))
    with pytest.raises(EnvcalError, match="no settings file"):
        config.load(tmp_path / "big.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"output: \xe4\n")
    with pytest.raises(EnvcalError, match="not UTF-8"):
        config.load(tmp_path / "latin.yaml")


def test_numbers_are_read_as_the_person_meant_them(tmp_path):
    loaded = load(
        tmp_path, "capture: {reference: f1.dng}\nmerge: {read_noise_e: 1e-1}\nspectra: {wavelengths: 400:700:10}\n"
    )
    assert loaded.settings.merge.read_noise_e == 0.1
    assert loaded.settings.spectra.wavelengths == "400:700:10"


def test_set_changes_a_setting_and_is_named_when_it_is_wrong(tmp_path):
    text = "capture: {reference: f1.dng}\n"
    loaded = load(tmp_path, text, overrides=["uplift.method=scaled", "balance.lamp={rectangle: [1, 2, 3, 4]}"])
    assert loaded.settings.uplift.method == "scaled"
    assert loaded.settings.balance.lamp.rectangle == (1, 2, 3, 4)
    assert mistakes(tmp_path, text, overrides=["uplift.nodes=2"])[0].startswith("--set uplift.nodes=2: uplift.nodes:")
    assert "expected key.key=value" in mistakes(tmp_path, text, overrides=["uplift"])[0]


def test_declared_lights_can_stand_in_a_file_of_their_own(tmp_path):
    (tmp_path / "lamp.csv").write_text("400,1\n700,2\n")
    path = tmp_path / "lights.yaml"
    path.write_text("lights:\n  - {at: [0.5, 0.1], type: led, cct: 4000}\n  - {at: [0, 0], spd: lamp.csv}\n")
    first, second = config.load_lights(path)
    assert (first.type, first.cct) == ("led", 4000)
    assert second.spd == tmp_path / "lamp.csv"
    path.write_text("lights:\n  - {at: [0.5, 0.1], tpye: led}\n")
    with pytest.raises(EnvcalError, match=r":2: .*did you mean `type`"):
        config.load_lights(path)


@pytest.mark.parametrize(
    "form",
    [
        "lights:\n- {at: [0.5, 0.1], type: led}\n",
        "- {at: [0.5, 0.1], type: led}\n",
        "cluster:\n  lights:\n  - {at: [0.5, 0.1], type: led}\n",
    ],
)
def test_declared_lights_may_stand_in_every_natural_form(tmp_path, form):
    path = tmp_path / "lights.yaml"
    path.write_text(form)
    (one,) = config.load_lights(path)
    assert (one.at, one.type) == ((0.5, 0.1), "led")
    path.write_text(form.replace("type", "tpye"))
    line = form.count("\n")
    with pytest.raises(EnvcalError, match=rf"lights.yaml:{line}: .*did you mean `type`") as caught:
        config.load_lights(path)
    assert "holds `lights: [{at: [0.84, 0.16], type: led}]`" in str(caught.value)


@pytest.mark.parametrize("text", ["", "3\n", "[]\n", "lights: 3\n", "lihgts: []\n", "cluster: {lihgts: []}\n"])
def test_a_lights_file_of_no_known_form_is_shown_one(tmp_path, text):
    path = tmp_path / "lights.yaml"
    path.write_text(text)
    if text == "[]\n":  # an empty list says that nothing is known
        assert config.load_lights(path) == ()
        return
    with pytest.raises(EnvcalError) as caught:
        config.load_lights(path)
    assert "holds `lights: [{at: [0.84, 0.16], type: led}]`" in str(caught.value)


def test_files_taken_for_one_another_are_called_what_they_are(tmp_path):
    for text in ("lights: [{at: [0, 0], type: led}]\n", "- {at: [0, 0], type: led}\n"):
        assert "is a lights.yaml" in mistakes(tmp_path, text)[0]
        assert "--lights" in mistakes(tmp_path, text)[0]
    path = tmp_path / "pipeline.yaml"
    path.write_text("capture: {reference: f1.dng}\ncluster: {lights: [{at: [0, 0], type: led}]}\n")
    with pytest.raises(EnvcalError, match=r"is a pipeline.yaml, which `envcal run` takes"):
        config.load_lights(path)


@pytest.mark.parametrize("begins", [b"\x76\x2f\x31\x01", b"#?RADIANCE", b"II*\0", b"\xff\xd8\xff\xe0", b"\x89PNG\r\n"])
def test_an_image_in_the_place_of_settings_is_called_one_however_large(tmp_path, begins):
    path = tmp_path / "studio.exr"
    for size in (10, 1 << 21):
        path.write_bytes(begins + bytes(size))
        with pytest.raises(EnvcalError, match=r"is an image; a pipeline.yaml is expected"):
            config.load(path)
        with pytest.raises(EnvcalError, match=r"is an image; a lights.yaml is expected"):
            config.load_lights(path)


def test_a_folder_in_the_place_of_settings_is_called_one_and_its_settings_named(tmp_path):
    with pytest.raises(EnvcalError, match=r"is a folder; a pipeline.yaml is expected.$"):
        config.load(tmp_path)
    (tmp_path / "pipeline.yaml").touch()
    with pytest.raises(EnvcalError, match=r"Give .*pipeline.yaml"):
        config.load(tmp_path)


def test_the_shipped_schema_and_pipeline_are_those_of_the_code():
    assert (ROOT / "pipeline.schema.json").read_text(encoding="utf-8") == config.schema()
    first = (ROOT / "pipeline.yaml").read_text(encoding="utf-8").splitlines()[0]
    assert first.endswith("$schema=pipeline.schema.json")
    assert json.loads(config.schema())["additionalProperties"] is False


def test_every_setting_has_a_description_for_editors():
    def walk(node, name):
        for key, value in node.get("properties", {}).items():
            described = "description" in value or "$ref" in value or key in ("observer",)
            assert described, f"{name}.{key} has no description"

    tree = json.loads(config.schema())
    for name, node in [("pipeline", tree), *tree["$defs"].items()]:
        walk(node, name)


@pytest.mark.parametrize(
    ("lamp", "told", "untold"),
    [
        ("{size: [0.05, 0.4], withn: 0.3}", ["balance.lamp.withn: is not a setting; did you mean `within`?"], "size"),
        (
            "{size: [0.05, 0.4], rectangle: [1, 2, 3, 4]}",
            ["balance.lamp.rectangle: cannot stand beside the other settings there; give one or the other"],
            "is not a setting",
        ),
        ("[1, 2, 3, 4, 5, 6, 7, 8]", ["expected {size: …, within: …}", "expected {rectangle: …}"], "Lamp"),
    ],
)
def test_a_mistake_in_one_of_several_mappings_is_told_in_the_words_of_the_file(tmp_path, lamp, told, untold):
    (tmp_path / "a.dng").write_bytes(b"")
    (tmp_path / "p.yaml").write_text(f"capture: {{reference: a.dng}}\noutput: o\nbalance: {{lamp: {lamp}}}\n")
    with pytest.raises(EnvcalError) as refused:
        config.load(tmp_path / "p.yaml")
    message = str(refused.value)
    assert all(part in message for part in told)
    assert untold not in message.replace(str(tmp_path), "")
