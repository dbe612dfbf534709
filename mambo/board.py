"""The library's settings by file: configs/mambo.yaml and what is laid over it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from configs.loader import CONFIG_DIRECTORY, fill, merge, read_tree, set_path
from mambo.config import BoardConfig

BOARD_FILE: Final = CONFIG_DIRECTORY / "mambo.yaml"


def board_config(
    path: Path | None = None, assignments: Sequence[str] = (), values: Mapping[str, Any] | None = None
) -> BoardConfig:
    """The library's settings.

    Parameters
    ----------
    path: file over configs/mambo.yaml, for example with the axes of another firmware; None: none.
    assignments: `path.to.key=value` over both.
    values: tree over all.

    Raises
    ------
    ConfigError
        Naming file, path, value and what is allowed.
    """
    tree, source = read_tree(BOARD_FILE), str(path or BOARD_FILE)
    if path is not None:
        tree = merge(tree, read_tree(path))
    for assignment in assignments:
        tree = set_path(tree, assignment)
    return fill(BoardConfig, merge(tree, values or {}), source + "".join(f" --set {one}" for one in assignments))
