"""The files beside the code: they parse, name what is there, and state what pyproject.toml states."""

from __future__ import annotations

import re
import shlex
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import fusion_sfdia
from fusion_sfdia.cli.main import parser

CONDA_NAMES = {"matplotlib": "matplotlib-base"}  # of packages that conda-forge names otherwise
COMMAND = re.compile(r"fusion-sfdia ([a-z][\w-]+)")


@pytest.fixture
def project(root: Path) -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    return found


def loaded(path: Path) -> dict[str, Any]:
    found = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert isinstance(found, dict), path
    return found


def instructions(text: str) -> list[tuple[str, str]]:
    """The instructions of a Dockerfile with their arguments."""
    text = re.sub(r"^\s*#.*\n", "", text, flags=re.MULTILINE).replace("\\\n", " ")
    return [(line.split(maxsplit=1)[0], line.split(maxsplit=1)[1].strip()) for line in text.splitlines() if line.strip()]


def test_the_citation_has_what_the_format_requires_and_the_project_states(root: Path, project: dict[str, Any]) -> None:
    cited = loaded(root / "CITATION.cff")
    assert cited["cff-version"] == "1.2.0" and cited["message"] and cited["title"].startswith(project["project"]["name"])
    assert cited["version"] == fusion_sfdia.__version__ and cited["license"] == project["project"]["license"]
    assert [a["name"] for a in cited["authors"]] == [a["name"] for a in project["project"]["authors"]]
    for paper in cited["references"]:
        assert {"type", "title", "authors", "year"} <= set(paper)
        assert all(set(author) == {"given-names", "family-names"} for author in paper["authors"])


def test_the_conda_recipe_has_the_requirements_and_the_command(root: Path, project: dict[str, Any]) -> None:
    recipe, metadata = loaded(root / "recipe.yaml"), project["project"]
    python, *needs = recipe["requirements"]["run"]
    assert python == f"python {metadata['requires-python']}" and python in recipe["requirements"]["host"]
    split = (re.fullmatch(r"([\w.-]+)(.*)", need) for need in metadata["dependencies"])
    assert needs == [f"{CONDA_NAMES.get(found[1], found[1])} {found[2]}" for found in split if found]
    assert {need.replace(" ", "") for need in recipe["requirements"]["host"]} >= {*project["build-system"]["requires"]}
    assert recipe["build"]["python"]["entry_points"] == [f"{k} = {v}" for k, v in metadata["scripts"].items()]
    assert (recipe["package"]["name"], str(recipe["package"]["version"])) == (metadata["name"], fusion_sfdia.__version__)
    assert (recipe["about"]["summary"], recipe["about"]["license"]) == (metadata["description"], metadata["license"])
    assert (root / recipe["about"]["license_file"]).is_file()


def test_the_image_is_pinned_runs_as_no_root_and_holds_no_secret(root: Path) -> None:
    found = instructions((root / "Dockerfile").read_text(encoding="utf-8"))
    assert all(re.match(r"python:3\.\d+-slim\b", argument) for name, argument in found if name == "FROM")
    last = found[len(found) - [name for name, _ in found][::-1].index("FROM") :]
    (user,) = (argument for name, argument in last if name == "USER")
    assert user not in ("root", "0")
    assert ("ENTRYPOINT", '["fusion-sfdia"]') in last
    assert not {"ADD", "ENV", "ARG"} & {name for name, _ in found}  # neither downloads nor anything that could be a secret
    copied = [shlex.split(argument) for name, argument in found if name == "COPY" and not argument.startswith("--from=build")]
    sources = {source for *names, _ in copied for source in names}
    assert all((root / source).exists() for source in sources)
    sent = (root / ".dockerignore").read_text(encoding="utf-8").split()
    assert sent[0] == "*" and {name[1:] for name in sent if name.startswith("!")} == sources


def test_the_image_has_what_the_build_needs(root: Path, project: dict[str, Any]) -> None:
    text = (root / "Dockerfile").read_text(encoding="utf-8")
    needs = {*project["tool"]["setuptools"]["package-dir"].values(), "pyproject.toml", project["project"]["readme"]}
    needs |= {*project["project"]["license-files"]}
    assert needs == {name for found in re.findall(r"^COPY (?!--)(.*) \S+$", text, re.MULTILINE) for name in found.split()}


def test_a_tag_alone_publishes_what_was_tested_without_a_password(root: Path) -> None:
    text = (root / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    flow = yaml.safe_load(text)
    assert flow[True] == {"push": {"tags": ["v*"]}}  # YAML 1.1 takes `on` for a boolean
    assert flow["permissions"] == {} and "secrets." not in text
    jobs = flow["jobs"]
    assert [name for name, job in jobs.items() if "id-token" in job["permissions"]] == ["publish"]
    assert set(jobs["publish"]["needs"]) == set(jobs) - {"publish"}
    steps = [step for job in jobs.values() for step in job["steps"]]
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@(v\d+|release/v\d+)", step["uses"]) for step in steps if "uses" in step)
    for script in (step["run"] for step in steps if "run" in step):
        checked = subprocess.run(["bash", "-n"], input=script, capture_output=True, text=True, check=False)
        assert checked.returncode == 0, checked.stderr
    assert (root / ".ci" / "run").is_file() and [step.get("run") for step in jobs["test"]["steps"]][-1] == ".ci/run"


def test_issue_forms_ask_for_what_is_needed(root: Path) -> None:
    forms = {path.stem: loaded(path) for path in (root / ".github" / "ISSUE_TEMPLATE").glob("*.yml")}
    assert set(forms) == {"bug", "wrong_diagnosis", "question"}
    for form in forms.values():
        assert form["name"] and form["description"]
        fields = [field["id"] for field in form["body"]]
        assert len(set(fields)) == len(fields)
        for field in form["body"]:
            assert field["type"] in ("textarea", "input") and field["attributes"]["label"]
    asked = {name: {field["id"] for field in form["body"]} for name, form in forms.items()}
    assert "check" in asked["bug"] and {"log", "manifest", "check"} <= asked["wrong_diagnosis"]


@pytest.mark.parametrize("folder", [".github/ISSUE_TEMPLATE", ".github/workflows", "Dockerfile", "SECURITY.md", "recipe.yaml"])
def test_commands_and_files_that_are_named_exist(root: Path, folder: str) -> None:
    known = next(action.choices for action in parser()._actions if action.dest == "command")
    assert known is not None
    place = root / folder
    for path in sorted(place.iterdir()) if place.is_dir() else [place]:
        text = path.read_text(encoding="utf-8")
        assert {*COMMAND.findall(text)} <= {*known}, path
        for named in re.findall(r"`((?:docs|tests|fusion_sfdia|models)/[\w./-]+)`", text):
            assert (root / named).exists(), named


def test_the_paper_cites_what_its_bibliography_has_and_takes_its_numbers_from_the_table(root: Path) -> None:
    folder = root / "docs" / "paper"
    text = (folder / "paper.md").read_text(encoding="utf-8")
    _, front, body = text.split("---\n", 2)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(yaml.safe_load(front))
    titles = re.findall(r"^# (.*)$", body, re.MULTILINE)
    assert titles[:4] == ["Summary", "Statement of need", "State of the field", "Functionality"] and titles[-1] == "References"
    keys = re.findall(r"^@\w+\{(\w+),", (folder / "paper.bib").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(re.findall(r"@(\w+)", body)) == set(keys) and len(set(keys)) == len(keys)
    assert set(re.findall(r"\\autoref\{([\w:]+)\}", body)) == set(re.findall(r"\\label\{([\w:]+)\}", body))
    prose = "\n".join(line for line in body.splitlines() if not line.startswith("|"))
    assert not re.search(r"\d", re.sub(r"@\w+", "", prose)), "a number outside the table has no source"
    assert 750 <= len(prose.split()) <= 1750  # as the Journal of Open Source Software asks for
