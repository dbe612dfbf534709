"""Classes that a configuration names: module:Class, file.py:Class, or a class object of this Python process.

A controller or a disturbance of a user's own can be written in three places:

- a module on the Python path: `my_module:MyController`;
- any file: `path/to/my_file.py:MyController`. A relative path in a YAML file counts from the folder of that file. The
  folder of the Python file is on the path while the file is imported;
- a notebook or an interactive session: `name_of` gives the class the name `this_session:MyController`, which only the
  same process can find again. The newest class of that name counts.
"""

import importlib.util
import sys
from collections.abc import Mapping
from hashlib import blake2b
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final

PATTERN: Final = r"^(?:[A-Za-z_][\w.]*|.+\.py):[A-Za-z_]\w*$"
"""Of a name: module:Class or file.py:Class."""
EXPECTED: Final = "expected module:Class, with the module on the Python path, or file.py:Class"
SESSION: Final = "this_session"

_session: Final[dict[str, type]] = {}
_files: Final[dict[Path, tuple[int, ModuleType]]] = {}
"""Modules by their file, with the time of its last change, ns."""


def find_class(name: str) -> Any:
    """The class of a name. A name from a configuration goes by `configs.named_class`, which knows what it may be.

    Raises
    ------
    ImportError
        If the file or the module cannot be imported, or has no such class; the message says why.
    """
    where, _, class_name = name.rpartition(":")
    if where == SESSION:
        if class_name not in _session:
            raise ImportError(
                f"{class_name} was defined in another Python session; write it into a file and name it file.py:Class"
            )
        return _session[class_name]
    try:
        module = _module_of_file(Path(where)) if where.endswith(".py") else import_module(where)
        return getattr(module, class_name)
    except AttributeError as error:
        raise ImportError(str(error)) from None
    except ImportError:
        raise
    except Exception as error:  # a file of the user's own may raise anything while it is imported
        raise ImportError(f"{type(error).__name__}: {error}") from error


def name_of(found: type) -> str:
    """A name by which `find_class` finds this class again, in every process if that is possible."""
    module, file = found.__module__, getattr(sys.modules.get(found.__module__), "__file__", None)
    names = [f"{module}:{found.__qualname__}"]
    if file is not None and "." not in module:
        names.insert(0, f"{Path(file).resolve()}:{found.__qualname__}")
    for name in names if module != "__main__" and "." not in found.__qualname__ else ():
        try:
            if find_class(name) is found:
                return name
        except ImportError:
            continue
    _session[found.__name__] = found
    return f"{SESSION}:{found.__name__}"


def with_absolute_file(tree: Mapping[str, Any], key: str, folder: Path) -> dict[str, Any]:
    """The tree with file.py:Class at `key` as an absolute path; a relative one counts from `folder`."""
    where, _, class_name = str(tree.get(key, "")).rpartition(":")
    if not where.endswith(".py"):
        return dict(tree)
    return {**tree, key: f"{(folder / where).resolve()}:{class_name}"}


def _module_of_file(path: Path) -> ModuleType:
    """The module of a file: the one that is imported already, else a new one. A changed file is imported again."""
    path = path.resolve()
    if not path.is_file():
        raise ImportError(f"there is no file {path}")
    changed_ns = path.stat().st_mtime_ns
    if path in _files and _files[path][0] == changed_ns:
        return _files[path][1]
    for name, module in list(sys.modules.items()):
        if name != "__main__" and path not in _files and getattr(module, "__file__", None) == str(path):
            return module
    name = f"user_{path.stem}_{blake2b(str(path).encode(), digest_size=4).hexdigest()}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # as import does: dataclasses and pydantic look the module up
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        sys.path.remove(str(path.parent))
    _files[path] = changed_ns, module
    return module
