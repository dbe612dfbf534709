"""Builds the C core into a wheel, where the machine that builds it has a C compiler.

Without one the wheel is pure Python; the core is then built at first use, if there is a compiler by then.
"""

import importlib.util
import sys
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CustomBuildHook(BuildHookInterface):
    """hatchling calls it before and after it builds a wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile into a temporary folder and name the files; an editable installation builds at first use."""
        if self.target_name != "wheel" or version == "editable":
            return
        core = _module(Path(self.root) / "onboard" / "c" / "compile.py")
        self._folder = tempfile.TemporaryDirectory()
        try:
            for variant in (core.DEFAULT, core.DEFAULT._replace(real="float")):
                name = core.prebuilt_name(variant)
                library, declared = (Path(self._folder.name) / f"{name}{end}" for end in (".so", core.DECLARED))
                core.compile_core(variant, library)
                declared.write_text(core.preprocessed_headers(variant), encoding="utf-8")
                for path in (library, declared):
                    build_data["force_include"][str(path)] = f"onboard/c/{core.PREBUILT.name}/{path.name}"
        except core.BuildError as error:
            build_data["force_include"].clear()
            self.app.display_warning(f"the C core is left out of this wheel: {error}")
            return
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary folder."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()


def _module(path: Path) -> ModuleType:
    """A module of the standard library alone, by its file: the package is not installed yet."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[f"_{path.stem}"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
