"""YAML: merging, the line of every mistake, and files that mean harm."""

import pytest
from pydantic import BaseModel, ConfigDict

from tacgen.core.errors import RecipeError
from tacgen.core.resources import packaged
from tacgen.core.schema import read_yaml, validate
from tests.messages import refused


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid")
    force_n: float
    name: str = "x"


class Outer(BaseModel):
    model_config = ConfigDict(extra="forbid")
    inner: Inner
    items: tuple[Inner, ...] = ()


def write(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


def test_every_problem_is_listed_with_its_line(tmp_path):
    path = write(tmp_path, "a.yaml", "inner:\n  force_n: ten\n  nmae: y\nitems:\n  - name: z\n")
    with refused(RecipeError):
        validate(Outer, read_yaml(path))


def test_extends_lays_the_file_over_its_base_key_by_key(tmp_path):
    write(tmp_path, "base.yaml", "inner:\n  force_n: 1\n  name: base\n")
    path = write(tmp_path, "a.yaml", "extends: base.yaml\ninner:\n  force_n: 2\n")
    assert validate(Outer, read_yaml(path)).inner == Inner(force_n=2, name="base")


def test_a_mistake_in_the_base_names_the_base(tmp_path):
    write(tmp_path, "base.yaml", "inner:\n  name: base\n  force_n: ten\n")
    path = write(tmp_path, "a.yaml", "extends: base.yaml\nitems: []\n")
    with refused(RecipeError):
        validate(Outer, read_yaml(path))


@pytest.mark.parametrize(
    "text",
    [
        "a: 1\na: 2\n",
        "- 1\n",
        "",
        "b: 1\na: [1,\n  2\nc:\n  d: 1\n",
        "b: 1\na: {c: 1\nd: [\n",
        "a: 'b\n",
        "a: !!python/object/apply:os.getcwd []\n",
        "extends: a.yaml\n",
    ],
)
def test_a_file_that_cannot_be_used_says_why(tmp_path, text):
    path = write(tmp_path, "a.yaml", text)
    with refused(RecipeError):
        validate(Outer, read_yaml(path))


def test_no_code_runs_from_a_tag(tmp_path):
    marker = tmp_path / "ran"
    path = write(
        tmp_path, "a.yaml", f"inner: !!python/object/apply:pathlib.Path.touch ['{marker}']\n"
    )
    with pytest.raises(RecipeError):
        validate(Outer, read_yaml(path))
    assert not marker.exists()


@pytest.mark.slow
def test_aliases_that_unfold_without_bound_are_refused(tmp_path):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    path = write(tmp_path, "bomb.yaml", "\n".join(lines))
    with refused(RecipeError):
        read_yaml(path)


def test_a_missing_file_is_named(tmp_path):
    with refused(RecipeError):
        read_yaml(tmp_path / "none.yaml")


def test_a_recipe_named_like_a_shipped_one_extends_that(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rig.yaml"
    path.write_text("extends: rig\nseed: 77\n")
    shipped = read_yaml(packaged("recipes") / "rig.yaml").data
    assert read_yaml(path).data == {**shipped, "seed": 77}
