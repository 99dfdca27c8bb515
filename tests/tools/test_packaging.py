"""What other package managers read agrees with `pyproject.toml`."""

import re
import tomllib
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import jinja2
import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ON_CONDA_FORGE = {"torch": "pytorch", "matplotlib": "matplotlib-base"}


def name_of(requirement: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[ \[<>=]", requirement)[0]).lower()


def test_the_lock_has_the_pinned_versions() -> None:
    text = (ROOT / "uv.lock").read_text(encoding="utf-8")
    packages: dict[str, set[str]] = {}
    for package in tomllib.loads(text)["package"]:
        packages.setdefault(package["name"], set()).add(package["version"])
    hosts = {urlsplit(url).netloc for url in re.findall(r'"(https?:[^"]+)"', text)}
    assert hosts == {"pypi.org", "files.pythonhosted.org"}
    extras = PROJECT["optional-dependencies"].values()
    required = [*PROJECT["dependencies"], *(line for extra in extras for line in extra)]
    assert {name_of(requirement) for requirement in required} <= packages.keys()
    constraints = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    pins = {name_of(name): v for name, v in re.findall(r"(?m)^([\w.-]+)==(\S+)", constraints)}
    assert pins.keys() <= packages.keys()
    differing = {name for name, version in pins.items() if packages[name] != {version}}
    assert differing == {"mkdocs-jupyter", "mkdocs-material", "pymdown-extensions", "soupsieve"}


def test_the_conda_recipe_has_the_requirements_and_commands() -> None:
    def load_file_data(name: str, from_recipe_dir: bool) -> dict[str, Any]:
        assert from_recipe_dir
        return tomllib.loads((ROOT / "conda" / name).read_text(encoding="utf-8"))

    recipe = (ROOT / "conda/meta.yaml").read_text(encoding="utf-8")
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined)
    text = environment.from_string(recipe).render(load_file_data=load_file_data, PYTHON="python")
    meta = yaml.safe_load(text)
    python, *run = meta["requirements"]["run"]
    assert python == f"python {PROJECT['requires-python']}"
    names = [ON_CONDA_FORGE.get(name_of(line), name_of(line)) for line in PROJECT["dependencies"]]
    assert sorted(map(name_of, run)) == sorted(names)
    versions = {line.split("=", 1)[1] for line in run}
    assert versions == {line.split("=", 1)[1] for line in PROJECT["dependencies"]}
    assert len(meta["build"]["entry_points"]) == len(PROJECT["scripts"])
    assert (ROOT / "conda" / meta["source"]["path"] / meta["about"]["license_file"]).is_file()
