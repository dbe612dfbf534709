"""The folder of a memory on disk. The content is read and written as a whole."""

from pathlib import Path

from configs.loader import ConfigError
from offboard.memory.memory import Condition, Memory, UnusableMemoryError, unlearnt
from offboard.memory.memory_file import FILE_NAME, dump_memory, load_memory, require_fit
from protocol.feature_config import TrainedFeatures
from runtime.files import make_folder, write_atomically


def memory_file(path: Path) -> Path:
    """The file of a memory: `path` itself, or the one in the folder `path`."""
    return path / FILE_NAME if path.is_dir() else path


def read_memory(path: Path) -> bytes:
    """The bytes of the memory in a folder, or of its file. Raises ConfigError."""
    file = memory_file(path)
    try:
        return file.read_bytes()
    except OSError as error:
        raise ConfigError(f"memory {path}: {file}: cannot be read: {error.strerror}") from None


def open_memory(path: Path) -> Memory:
    """The memory in a folder. Raises ConfigError, naming the folder, if there is none or it cannot be used."""
    try:
        return load_memory(read_memory(path))
    except UnusableMemoryError as error:
        raise ConfigError(f"memory {path}: {error}") from None


def write_memory(folder: Path, memory: Memory) -> None:
    """Write the memory into the folder, which is made. Raises StartError or OSError."""
    make_folder(folder)
    write_atomically(folder / FILE_NAME, dump_memory(memory))


def remember(folder: Path, condition: Condition, features: TrainedFeatures) -> Memory:
    """Add a condition to the memory in a folder, as it is now, or begin one, and write it.

    Raises
    ------
    ConfigError
        If the memory cannot be used, or was made for other networks than `features`.
    """
    try:
        known = open_memory(folder) if memory_file(folder).exists() else unlearnt(features)
        require_fit(known.features, features)
        memory = known.with_condition(condition)
    except UnusableMemoryError as error:
        raise ConfigError(f"memory {folder}: {error}") from None
    write_memory(folder, memory)
    return memory
