"""Jobs written down: what each format says, what is refused and where, and that writing is read."""

import io
import json
import sys
from dataclasses import fields
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from command import Desk
from command import hpcomp as hpcomp_command

import hpcomp
from hpcomp.blending.blendings import BLENDINGS
from hpcomp.errors import InputError, SettingError
from hpcomp.jobs import schema
from hpcomp.layers.layerspec import LayerSpec
from hpcomp.options import OPTIONS


def document(job):
    """A job as plain data, without what errors call it."""
    return job.document()


#: Two jobs, in every format that can say them.
EXPECTED = [
    {
        "layers": [{"path": "base.png"}, {"path": "roads.png", "opacity": 0.6, "op": "atop"}],
        "output": "map.png",
        "depth": "16",
        "hue_tolerance": 0.5,
        "strict": True,
    },
    {"layers": [{"path": "base.png"}], "output": "plain.exr", "depth": "float", "threads": 2,
     "strict": True},
]  # fmt: skip

TOML = """
version = 1

[defaults]  # output = "a comment"
strict = true

[[jobs]]
layers = ["base.png", { path = "roads.png", opacity = 0.6, op = "atop" }]
output = "map.png"
depth = "16"
hue_tolerance = 0.5

[[jobs]]
output = "plain.exr"
depth = "float"
threads = 2
[[jobs.layers]]
path = "base.png"
"""
JOBS = [
    {"layers": ["base.png", "roads.png::opacity=0.6,op=atop"], "output": "map.png",
     "depth": "16", "hue_tolerance": 0.5},
    {"layers": ["base.png"], "output": "plain.exr", "depth": "float", "threads": 2},
]  # fmt: skip
HEAD = {"version": 1, "defaults": {"strict": True}}
FILES = {
    "jobs.toml": TOML,
    "jobs.json": json.dumps({**HEAD, "jobs": JOBS}, indent=1),
    "jobs.jsonl": "\n\n".join(json.dumps(table) for table in (HEAD, *JOBS)),
    "jobs.ndjson": "".join(f"{json.dumps({**job, 'strict': True})}\r\n" for job in JOBS),
    "jobs.csv": "output,layer,layer,depth,hue_tolerance,threads,strict\n"
    'map.png,base.png,"roads.png::opacity=0.6,op=atop",16,0.5,,true\n'
    "\nplain.exr,base.png,,float,,2,yes\n",
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["", "bom"])
def test_every_format_says_the_same(tmp_path, name, mark):
    (tmp_path / name).write_text(mark + FILES[name], encoding="utf-8")
    jobs = hpcomp.read_jobs(tmp_path / name)
    assert [document(job) for job in jobs] == EXPECTED


@pytest.mark.parametrize("name", FILES)
def test_stdin_with_a_format(monkeypatch, name):
    stdin = io.TextIOWrapper(io.BytesIO(FILES[name].encode()))
    monkeypatch.setattr(sys, "stdin", stdin)
    kind = {"ndjson": "jsonl"}.get(name[5:], name[5:])
    assert [document(job) for job in hpcomp.read_jobs("-", format=kind)] == EXPECTED


@pytest.mark.parametrize("text", [json.dumps(JOBS), json.dumps(JOBS[0]), json.dumps({"jobs": JOBS})])
def test_a_list_of_jobs_and_a_single_job_are_documents(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    jobs = hpcomp.read_jobs(tmp_path / "a.json")
    assert [job.output for job in jobs] == ["map.png", "plain.exr"][: len(jobs)]


def test_options_of_a_job_are_those_of_stack_and_a_layer_has_all_its_settings():
    every = {
        "path": "a.exr", "op": "xor", "opacity": 1, "at": "+3-4", "alpha": "luminance",
        "tint": "#123456", "part": 2, "layer": "diffuse", "name": "leaf",
    }  # fmt: skip
    options = {
        "order": [1, 0], "background": [0.5, 0, 1], "depth": 16, "max_memory": 1 << 29,
        "report": ["a.html", "b.json"], "clobber": False, "exposure": -1, "bins": 72,
    }  # fmt: skip
    (job,) = schema.jobs_of([{"layers": ["b.png", every], "output": "o.png", **options}])
    assert job.layers[1] == LayerSpec(**{**every, "part": "2"})
    assert dict(job.options) == options
    assert job.inputs == ["b.png", "a.exr"]
    assert job.outputs == ["o.png", "a.html", "b.json"]


#: (file, its text, the error and what it has to say).
REFUSED = [
    ("a.toml", "[[jobs]]\nlayers = ['a']\n\noutput = 'o.png'\nblendign = 'x'\n",
     "a.toml:5: job 1: unknown key of a job 'blendign': did you mean 'blending'"),
    ("a.toml", "[[jobs]]\nlayers=['a']\noutput='o.png'\nspace='xyz'\n# spcae = 1\n[[jobs]]\n"
     "layers=['a']\noutput='spcae = 1'\nspcae='xyz'\n", "a.toml:9: job 2: unknown key"),
    ("a.toml", "[[jobs]]\noutput='o.png'\n[[jobs.layers]]\npath='a'\n[[jobs.layers]]\n"
     "path='b'\nopactiy=0.5\n",
     "a.toml:7: job 1: layer 1: unknown key of a layer 'opactiy': did you mean 'opacity'"),
    ("a.toml", "[default]\nspace='xyz'\n",
     "a.toml:1: unknown key of a job file 'default': did you mean 'defaults'"),
    ("a.toml", "[defaults]\n\noutput='xyz'\n", "a.toml:3: defaults: unknown option"),
    ("a.toml", "version = 2\n", "a.toml:1: version 2 of the schema is not known"),
    ("a.json", '{"jobs": [{"layers": ["a"], "output": "o.png"},\n {"layers": [{"path": "b",\n '
     '"tinted": 1}], "output": "p.png"}]}', "a.json:3: job 2: layer 0: unknown key"),
    ("a.json", '[{"layers": ["a"], "output": "o.png",\n "strict": "yes"}]',
     'a.json:2: job 1: strict is "yes": it takes true or false'),
    ("a.json", '[{"layers": ["a"], "output": "o.png", "threads": 1.5}]',
     "threads is 1.5: it takes a whole number"),
    ("a.json", '[{"layers": ["a"], "output": "o.png", "bins": true}]', "bins is true"),
    ("a.json", '[{"layers": ["a"],\n"output": null}]', "a.json:2: job 1: output is null"),
    ("a.json", '[{"layers": ["a"], "output": "o", "output": "p"}]', "'output' stands twice"),
    ("a.json", '[{"output": "o.png"}]', "a.json: job 1: it has no layers"),
    ("a.json", '[{"layers": ["a"]}]', "it has no output"),
    ("a.json", '[{"layers": [], "output": "o.png"}]', "not a list of at least one LAYER"),
    ("a.json", '[{"layers": "a.png", "output": "o.png"}]', "not a list of at least one LAYER"),
    ("a.json", '[{"layers": [3], "output": "o.png"}]', "layer 0: it is neither"),
    ("a.json", '[{"layers": [{"op": "over"}], "output": "o.png"}]', "layer 0: it has no path"),
    ("a.json", '[{"layers": ["-::op=in"], "output": "o.png"}]', "cannot read stdin"),
    ("a.json", '[{"layers": ["a"], "output": "-", "format": "png"}]', "cannot write to stdout"),
    ("a.json", '["a.png"]', "job 1: it is no table"),
    ("a.json", "[]", "there are no jobs"),
    ("a.json", "3", "holds neither jobs nor a job"),
    ("a.json", '{"jobs": {}}', "jobs is not a list"),
    ("a.json", '{"version": true, "jobs": []}', "version true"),
    ("a.jsonl", '\n{"layers": ["a"], "output": "o.png"}\n{"layers": ["a::opacity=2"], "output": "p.png"}',
     "a.jsonl:3: layer 0: opacity 2 is outside"),
    ("a.jsonl", '{"layers": ["a"], "output": "o.png"}\n{"version": 1}', "a.jsonl:2: it has no layers"),
    ("a.jsonl", '{"layers": ["a"], "output": "o", "output": "p"}', "a.jsonl: key 'output' stands twice"),
    ("a.jsonl", '\n{"layers": [{"path": "a", "path": "b"}], "output": "o"}', "a.jsonl:2: key 'path' stands twice"),
    ("a.jsonl", '{"layers": ["a"], "output": "o.png", "blendign": 1}', "did you mean 'blending'"),
    ("a.jsonl", '{"layers": [{"path": "a", "opactiy": 1}], "output": "o"}', "layer 0: unknown key of a layer"),
    ("a.jsonl", '{"layers": ["a"], "output": "o.png", "version": 2}', "version 2 of the schema"),
    ("a.jsonl", '{"layers": ["a"], "output": "o.png", "order": [0.5]}',
     "order is [0.5]: it takes a text or a list, each a whole number"),
    ("a.csv", "output,layer,opt\no.png,a,1\n", "a.csv:1: unknown column 'opt'"),
    ("a.csv", "output,layer,output\n", "column 'output' stands twice"),
    ("a.csv", 'output,layer,bins\n"o\n.png",a,30\np.png,a,x\n',
     "a.csv:4: bins is 'x': it takes a whole number"),
    ("a.csv", "output,layer\no.png,a,b\n", "a.csv:2: 3 cells, but 2 columns"),
    ("a.csv", "output,layer\no.png,\n", "a.csv:2: it has no layers"),
    ("a.txt", "", "ends in none of .toml"),
    ("a.toml", '[[jobs]]\nlayers = ["a"]\noutput = "o.png"\n\n[defaults]\nfoo = 2\n\n[[jobs]]\nfoo = 3\n',
     "a.toml:6: defaults: unknown"),
    ("a.toml", '[[jobs]]\nlayers = ["a"]\noutput = "o.png"\n\n[defaults]\nbins = 20\n\n[[jobs]]\nlayers = ["b"]\n'
     'output = "p.png"\nbins = "x"\n', "a.toml:11: job 2: bins"),
    ("a.toml", 'defaults = { strict = true, foo = 2 }\n[[jobs]]\nfoo = 3\n', "a.toml:1: defaults: unknown"),
    ("a.toml", "jobs = [2024-01-01]", "job 1: it is no table"),
    ("a.json", '[{"layers": ["a\\u0000b"], "output": "o.png"}]', "is no name of a file"),
    ("a.json", '[{"layers": ["a"], "output": "o\\ud800.png"}]', "is no name of a file"),
    ("a.json", '[{"layers": ["a"], "output": "o.png", "depfile": "-"}]', "cannot write to stdout"),
]  # fmt: skip

#: Likewise values that a schema does not know to be wrong: of an option, or beside the others.
REFUSED_VALUES = [
    *(
        (f"a.{ending}", text.replace("KEY", key).replace("VALUE", value), f"a.{ending}:{line}: {where}{said}")
        for key, value, said in (
            ("space", "oklb", "unknown blending space 'oklb': did you mean 'oklab'?"),
            ("report", "x.xyz", "report x.xyz: its ending names no format: end it in .txt,"),
            ("provenance", "x.png", "provenance x.png is an EXR"),
            ("order", "1,2", "order 1,2 is not a permutation"),
            ("order", "upwards", "unknown order 'upwards'"),
            ("depth", "half", "unknown PNG depth 'half'"),
            ("compression", "zip", "unknown PNG compression 'zip'"),
            ("region", "1,2,3,4", "region: '1,2,3,4' is not a window"),
            ("canvas", "botom", "unknown canvas 'botom': did you mean 'bottom'?"),
            ("background", "rde", "background: 'rde' is not a colour"),
            ("max_memory", "lots", "max_memory: 'lots' is not an amount of memory"),
            ("energy_weights", "1,2", "energy weights 1,2 are not three numbers"),
            ("op", "ovr", "unknown operator 'ovr': did you mean 'over'?"),
        )
        for ending, line, where, text in (
            ("toml", 5, "job 1: ", "[[jobs]]\nlayers = ['a']\noutput = 'o.png'\n\nKEY = 'VALUE'\n"),
            ("json", 2, "job 1: ", '[{"layers": ["a"], "output": "o.png",\n"KEY": "VALUE"}]'),
            ("jsonl", 2, "", '\n{"layers": ["a"], "output": "o.png", "KEY": "VALUE"}'),
            ("csv", 2, "", 'output,layer,KEY\no.png,a,"VALUE"\n'),
        )
    ),
    ("a.jsonl", '{"layers": ["a"], "output": "o.exr", "out_primaries": "rec709"}', "an EXR is written in"),
    ("a.json", '{"layers": ["a"], "output": "o.xyz"}', "job 1: output o.xyz does not say its format"),
    ("a.json", '[{"layers": ["a"], "output": "o.png", "exposure": Infinity}]', "exposure inf is outside"),
    ("a.json", '{"defaults": {"hue_tolerance": 400}, "jobs": []}', "defaults: hue tolerance 400 is outside"),
]


@pytest.mark.parametrize(("name", "text", "says"), REFUSED + REFUSED_VALUES, ids=lambda v: v[-24:])
def test_what_is_refused_and_where(tmp_path, monkeypatch, name, text, says):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text)
    with pytest.raises(SettingError) as refused:
        hpcomp.read_jobs(name)
    assert says in str(refused.value)
    assert str(refused.value).startswith(name)


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("a.toml", b"a = \n", "a.toml: is not TOML: .* line 1"),
        ("a.json", b"{\n3}", "a.json:2: is not JSON"),
        ("a.jsonl", b"{}\n{", "a.jsonl:(1|2): "),
        ("a.csv", b'output,layer\n"o.png,a\n', "a.csv:2: is not CSV"),
        ("a.toml", b"# x\n# \xff\n", "a.toml:2: is not text in UTF-8"),
        ("none.toml", None, "none.toml: cannot be read: no such file"),
        ("a.json", b"[" * 100_000, "a.json: is not JSON that can be read"),
        ("a.json", b"[" + b"9" * 5000 + b"]", "a.json: is not JSON that can be read"),
        ("a.toml", b"a = " + b"9" * 5000, "a.toml: is not TOML"),
        ("a.toml", b"a = " + b"[" * 5000, "a.toml: is not TOML"),
    ],
)  # fmt: skip
def test_what_cannot_be_read(tmp_path, monkeypatch, name, data, says):
    monkeypatch.chdir(tmp_path)
    if data is not None:
        Path(name).write_bytes(data)
    with pytest.raises((InputError, SettingError), match=says):
        hpcomp.read_jobs(name)


def test_jobs_of_python_name_the_job():
    with pytest.raises(SettingError, match="job 2: it has no output"):
        schema.jobs_of([JOBS[0], {"layers": ["a"]}])


# ---- writing -------------------------------------------------------------------------------------


def flat(value, size=(4, 6)):
    return np.full((*size, 4), value, np.float32)


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    hpcomp.write_image(desk / "base.png", flat(1.0))
    hpcomp.write_image(desk / "top.exr", flat(0.5))
    return desk


ARGUMENTS = ["--depth", "16", "--order", "1,0", "--hue-tolerance", "0", "--strict", "--report", "r.json"]


@pytest.mark.parametrize("name", ["job.json", "job.jsonl"])
def test_stack_saves_its_job_instead_of_making_it(desk, name):
    desk.makes("stack", "base.png", "top.exr::opacity=0.5", "-o", "a.png", *ARGUMENTS, "--save-job", name)
    assert not (desk / "a.png").exists()
    (job,) = hpcomp.read_jobs(desk / name)
    assert document(job) == {
        "layers": [{"path": "base.png"}, {"path": "top.exr", "opacity": 0.5}], "output": "a.png",
        "depth": "16", "order": "1,0", "hue_tolerance": 0.0, "strict": True, "report": ["r.json"],
    }  # fmt: skip


def test_json_lines_grow_and_json_is_replaced(desk):
    for name in ("jobs.jsonl", "jobs.json"):
        for output in ("a.png", "b.png"):
            desk.makes("stack", "base.png", "-o", output, "--save-job", name)
    assert [job.output for job in hpcomp.read_jobs(desk / "jobs.jsonl")] == ["a.png", "b.png"]
    assert [job.output for job in hpcomp.read_jobs(desk / "jobs.json")] == ["b.png"]
    assert json.loads((desk / "jobs.json").read_text())["version"] == schema.SCHEMA_VERSION


def test_what_no_job_can_say_is_refused(desk):
    stack = ("stack", "base.png", "-o")
    desk.refuses(2, *stack, "a.png", "--save-job", "a.toml", says=["a.toml", ".json"])
    desk.refuses(2, *stack, "-", "--format", "png", "--save-job", "a.json", says=["stdout"])
    desk.refuses(2, "stack", "-", "-o", "a.png", "--save-job", "a.json", says=["layer 0", "stdin"])
    desk.refuses(5, *stack, "a.png", "--save-job", "none/a.jsonl", says=["none/a.jsonl"])


def test_saving_reads_what_was_saved(tmp_path):
    jobs = schema.jobs_of(JOBS)
    for name in ("a.json", "a.jsonl"):
        hpcomp.save_jobs(jobs, tmp_path / name)
        assert [document(j) for j in hpcomp.read_jobs(tmp_path / name)] == [*map(document, jobs)]


# ---- the schema ----------------------------------------------------------------------------------


def is_valid(document):
    return jsonschema.Draft202012Validator(schema.json_schema()).is_valid(document)


@pytest.fixture(scope="module")
def printed():
    run = hpcomp_command("batch", "--schema")
    assert (run.code, run.stderr) == (0, "")
    return json.loads(run.stdout)


def test_the_schema_that_is_printed_is_one(printed):
    jsonschema.Draft202012Validator.check_schema(printed)
    assert printed == schema.json_schema()
    assert printed["title"].endswith(f"version {schema.SCHEMA_VERSION}")


@pytest.mark.parametrize(
    "document", [json.loads(FILES["jobs.json"]), JOBS, JOBS[0], {"jobs": []}, {"version": 1, "jobs": JOBS}]
)
def test_the_schema_takes_what_is_read(document):
    assert is_valid(document)


@pytest.mark.parametrize(
    ("name", "text"), [(name, text) for name, text, _ in REFUSED if name == "a.json"], ids=range(len([r for r in REFUSED if r[0] == "a.json"]))
)
def test_the_schema_takes_nothing_that_is_refused_for_its_form(name, text):
    """But for what JSON Schema cannot see: keys that stand twice, values that `stack` looks up."""
    beyond = ("-::op", '"-"', '"output": "o", "output"', "\\u0000", "\\ud800")
    if any(word in text for word in beyond) or text == "[]":
        return
    assert not is_valid(json.loads(text))


def test_every_option_of_stack_is_in_the_schema():
    job = schema.json_schema()["$defs"]["job"]["properties"]
    assert set(job) == {"version", "layers", "output", *OPTIONS}
    for name, row in OPTIONS.items():
        assert job[name]["description"] == row.option.help
        assert job[name]["default"] == (list(row.default) if row.default == () else row.default)
    assert job["depth"]["anyOf"] == [{"type": "string"}, {"type": "integer"}, {"type": "null"}]
    assert job["depth"]["enum"] == ["8", "16", "half", "float", 8, 16, None]
    assert job["blending"]["enum"] == list(BLENDINGS)
    assert job["report"]["anyOf"] == [
        {"type": "string"}, {"type": "array", "items": {"type": "string"}},
    ]  # fmt: skip


def test_every_key_of_a_layer_is_in_the_schema():
    layer = schema.json_schema()["$defs"]["layer"]
    assert set(layer["properties"]) == {field.name for field in fields(LayerSpec)}
    assert layer["required"] == ["path"]
    assert all(row["description"] for row in layer["properties"].values())
    assert "dst-in" in layer["properties"]["op"]["enum"]


@pytest.mark.parametrize(
    "changed", [{"blending": "hue"}, {"depth": 12}, {"layers": ["a", {"path": "b", "opacity": 2}]},
                {"layers": ["a", {"path": "b", "op": "ovre"}]}, {"threads": 0}]
)  # fmt: skip
def test_the_schema_knows_values_that_only_stack_refuses(changed):
    assert is_valid(JOBS[0])
    assert not is_valid({**JOBS[0], **changed})


# ---- typed decoding ------------------------------------------------------------------------------

#: Jobs of JSON Lines, and whether msgspec can decode them by type alone.
DECODED = [
    ('{"layers": ["a"], "output": "o.png"}', True),
    ('{"layers": ["a", {"path": "b", "part": 2}], "output": "o.png", "hue_tolerance": 1}', True),
    ('{"output" :"o.png", "layers"\t: ["a"], "order": [0], "depth": 8, "report": ["r.txt"]}', True),
    ('{"layers": ["\\u0061"], "output": "o.png", "format": null}', True),
    ('{"layers": ["a\\":b"], "output": "o.png"}', False),  # what looks like one more key
    ('{"layers": [{"path": ":"}, ":"], "output": ":.png"}', False),
]


@pytest.mark.parametrize(("line", "typed"), DECODED)
def test_decoding_by_type_finds_what_the_table_says(tmp_path, line, typed):
    found = schema.decoded_job(line)
    assert (found is not None) == typed
    table = json.loads(line)
    assert found in (table, None)
    (tmp_path / "a.jsonl").write_text(line)
    (tmp_path / "a.json").write_text(f"[{line}]")
    wanted = document(schema.checked_job(table, {}, "job"))
    for name in ("a.jsonl", "a.json"):
        (job,) = hpcomp.read_jobs(tmp_path / name)
        assert document(job) == wanted
