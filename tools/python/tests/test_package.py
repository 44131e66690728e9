"""What the package says of itself is so."""

import tomllib

import yaml
from conftest import ROOT

HERE = ROOT / "tools/python"


def toml(path):
    return tomllib.loads(path.read_text())


def test_the_source_distribution_has_the_package_page():
    page = toml(HERE / "pyproject.toml")["project"]["readme"]
    assert (HERE / page).read_text().startswith("# isospan for Python\n")
    # Both folders are one in a source distribution, where the file of this one wins.
    assert not (ROOT / page).exists()


def test_the_conda_recipe_makes_this_package():
    recipe = yaml.safe_load((HERE / "conda/recipe.yaml").read_text())
    project = toml(HERE / "pyproject.toml")
    assert toml(HERE / "Cargo.toml")["package"]["version"] == {"workspace": True}
    workspace = toml(ROOT / "Cargo.toml")["workspace"]
    assert recipe["context"]["version"] == workspace["package"]["version"]
    assert recipe["about"]["license"] == project["project"]["license"]
    assert recipe["about"]["summary"] == project["project"]["description"]
    needed = {line.replace(" ", "") for line in recipe["requirements"]["host"]}
    assert set(project["build-system"]["requires"]) <= needed
    needed = {line.replace(" ", "") for line in recipe["requirements"]["run"]}
    assert set(project["project"]["dependencies"]) <= needed
    root = (HERE / "conda" / recipe["source"]["path"]).resolve()
    assert root == ROOT and all((root / f).exists() for f in recipe["about"]["license_file"])
    for choice in recipe["build"]["script"]:
        assert "./tools/python " in choice["then"] and "./tools/python " in choice["else"]
