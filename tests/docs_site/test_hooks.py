"""The hooks of the documentation site: where links lead, and the page of the commands."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import nbformat
import pytest

from async_dmrac.command_line import SUBCOMMANDS

pytest.importorskip("mkdocs")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "docs_site" / "hooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("page", "target", "leads_to"),
    [
        ("index.md", "docs/results.md", "results.md"),
        ("index.md", "docs/control.md#a-controller-of-your-own", "control.md#a-controller-of-your-own"),
        ("index.md", "docs/data", None),
        ("architecture.md", "../CONTRIBUTING.md#a-message", "contributing.md#a-message"),
        ("architecture.md", "../onboard/c/README.md", "core_in_c.md"),
        ("experiments.md", "../sim_vehicle/vehicle.py", "source/sim_vehicle/vehicle.py.txt"),
        ("logs.md", "pictures/viewer.png", "pictures/viewer.png"),
        ("reference/messages.md", "../protocol.md", "../protocol.md"),
        ("logs.md", "https://rerun.io", "https://rerun.io"),
        ("logs.md", "#export", "#export"),
    ],
)
def test_a_link_leads_to_the_same_thing_in_the_site(
    page: str, target: str, leads_to: str | None, hooks: ModuleType
) -> None:
    assert hooks.relocated(target, hooks.base_of(page), page.count("/")) == leads_to


def test_every_subcommand_is_in_the_reference(hooks: ModuleType) -> None:
    page = hooks.commands_page()
    for name, subcommand in SUBCOMMANDS.items():
        assert f"## dmrac {name}\n" in page
        assert subcommand.help in page
    assert "--lockstep" in page


def test_every_example_is_a_page_and_a_notebook_of_the_site(hooks: ModuleType) -> None:
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for example in (ROOT / "examples").glob("*.py"):
        files = hooks.notebook_files(example)
        page, notebook = files[f"notebooks/{example.stem}.md"], files[f"notebooks/{example.stem}.ipynb"]
        assert f"notebooks/{example.stem}.md" in site
        assert page.startswith("# ")
        assert f"({example.stem}.ipynb)" in page
        cells = nbformat.reads(notebook, as_version=4).cells
        code = "\n".join(cell.source for cell in cells if cell.cell_type == "code")
        shown = [line for line in example.read_text(encoding="utf-8").splitlines() if not line.startswith("# ")]
        assert [line for line in code.splitlines() if line.strip()] == [line for line in shown if line.strip()]
        assert all(cell.source in page for cell in cells)
