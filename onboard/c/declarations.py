"""Reads the core's own C headers: structures, enumerations and functions as ctypes declares them.

The headers are written in a small part of C: `typedef struct { ... } Name;`, `typedef enum { ... } Name;` and
prototypes. What is not understood is an error, so a header cannot be half read.
"""

import ctypes
import re
from typing import Any, Final

import numpy as np

PLAIN: Final[dict[str, Any]] = {
    "double": ctypes.c_double,
    "float": ctypes.c_float,
    "_Bool": ctypes.c_bool,
    "int": ctypes.c_int,
    "char": ctypes.c_char,
    "int8_t": ctypes.c_int8,
    "int16_t": ctypes.c_int16,
    "int32_t": ctypes.c_int32,
    "int64_t": ctypes.c_int64,
    "uint8_t": ctypes.c_uint8,
    "uint32_t": ctypes.c_uint32,
    "uint64_t": ctypes.c_uint64,
    "size_t": ctypes.c_size_t,
}
_STATEMENT: Final = re.compile(
    r"\s*(?:typedef\s+struct\s*\{(?P<struct>[^{}]*)\}\s*(?P<struct_name>\w+)"
    r"|typedef\s+enum\s*\{(?P<enum>[^{}]*)\}\s*(?P<enum_name>\w+)"
    r"|typedef\s+(?P<old>\w+)\s+(?P<new>\w+)"
    r"|(?P<result>[\w\s]+?[\s*]+)(?P<function>\w+)\s*\((?P<parameters>[^()]*)\))\s*;"
)
_FIELD: Final = re.compile(r"\s*(?:const\s+)?(?P<type>\w+)\s+(?P<star>\*?)(?P<name>\w+)(?P<array>(?:\[[^\]]+\])*)\s*$")
_PARAMETER: Final = re.compile(
    r"\s*(?P<const>const\s+)?(?P<type>\w+)\s*(?P<star>\*?)\s*(?P<name>\w+)(?P<array>\[\w*\])?\s*$"
)


class DeclarationError(Exception):
    """A header that says something this file does not understand."""


class _ArrayArgument:
    """A pointer to numbers: takes a contiguous numpy array of the right type, a ctypes array, or bytes."""

    dtype: np.dtype[Any]
    plain: Any
    constant: bool

    @classmethod
    def from_param(cls, value: Any) -> Any:
        """What ctypes passes to the function. Raises TypeError for another type of number, which C would misread."""
        if type(value) is bytes and cls.constant and cls.plain is ctypes.c_uint8:
            return value
        if isinstance(value, np.ndarray):
            if value.dtype != cls.dtype or not value.flags.c_contiguous:
                raise TypeError(f"array of {value.dtype}, expected contiguous {cls.dtype}")
            return value.ctypes
        if isinstance(value, ctypes.Array) and value._type_ is cls.plain:
            return value
        raise TypeError(f"{type(value).__name__}, expected an array of {cls.dtype}")


class Declarations:
    """What the preprocessed headers declare: `structures`, `constants` (of enumerations) and `functions`."""

    def __init__(self, text: str) -> None:
        """Raises DeclarationError for what is not understood."""
        self.types: dict[str, Any] = dict(PLAIN)
        self.structures: dict[str, type[ctypes.Structure]] = {}
        self.constants: dict[str, int] = {}
        self.functions: dict[str, tuple[Any, list[Any]]] = {}
        """Result and arguments of each function, as ctypes has them."""
        self._arrays: dict[tuple[str, bool], Any] = {}
        at = 0
        while text[at:].strip():
            statement = _STATEMENT.match(text, at)
            if statement is None:
                raise DeclarationError(f"not understood: {text[at : at + 120].strip()!r}")
            self._declare(statement)
            at = statement.end()

    def _declare(self, statement: re.Match[str]) -> None:
        if statement["struct"] is not None:
            self._structure(statement["struct_name"], statement["struct"])
        elif statement["enum"] is not None:
            self._enumeration(statement["enum_name"], statement["enum"])
        elif statement["old"] is not None:
            self.types[statement["new"]] = self._type(statement["old"])
        else:
            self._function(statement["function"], statement["result"], statement["parameters"])

    def _structure(self, name: str, body: str) -> None:
        fields = []
        for line in body.split(";")[:-1]:
            field = _FIELD.match(line)
            if field is None:
                raise DeclarationError(f"{name}: field {line.strip()!r} not understood")
            kind = self._type(field["type"])
            if field["star"]:
                kind = ctypes.POINTER(kind)
            for length in reversed(re.findall(r"\[([^\]]+)\]", field["array"])):
                kind = kind * _number(length)
            fields.append((field["name"], kind))
        self.types[name] = self.structures[name] = type(name, (ctypes.Structure,), {"_fields_": fields})

    def _enumeration(self, name: str, body: str) -> None:
        value = -1
        for entry in filter(None, (part.strip() for part in body.split(","))):
            label, _, given = (part.strip() for part in entry.partition("="))
            value = _number(given) if given else value + 1
            self.constants[label] = value
        self.types[name] = ctypes.c_int

    def _function(self, name: str, result: str, parameters: str) -> None:
        given = [] if parameters.strip() == "void" else parameters.split(",")
        words = [word for word in result.replace("*", " * ").split() if word != "const"]
        returned = None if words == ["void"] else self._type(words[0])
        if words[1:] == ["*"]:
            returned = ctypes.POINTER(returned)
        elif words[1:]:
            raise DeclarationError(f"{name}: result {result.strip()!r} not understood")
        self.functions[name] = returned, [self._argument(name, parameter) for parameter in given]

    def _argument(self, function: str, text: str) -> Any:
        parameter = _PARAMETER.match(text)
        if parameter is None:
            raise DeclarationError(f"{function}: parameter {text.strip()!r} not understood")
        kind = self._type(parameter["type"])
        if not parameter["star"] and parameter["array"] is None:
            return kind
        if parameter["type"] in self.structures:
            return ctypes.POINTER(kind)
        return self._array_argument(parameter["type"], kind, constant=parameter["const"] is not None)

    def _array_argument(self, name: str, kind: Any, constant: bool) -> Any:
        if (name, constant) not in self._arrays:
            members = {"dtype": np.dtype(kind), "plain": kind, "constant": constant}
            self._arrays[name, constant] = type(f"{name}_array", (_ArrayArgument,), members)
        return self._arrays[name, constant]

    def _type(self, name: str) -> Any:
        if name not in self.types:
            raise DeclarationError(f"type {name!r} is not known here")
        return self.types[name]


def _number(text: str) -> int:
    """The value of a constant expression of whole numbers, + - * / and brackets."""
    plain = " ".join(re.sub(r"(?<=\d)[uUlL]+", "", text).split())
    if not re.fullmatch(r"[\d\s()+*/-]+", plain):
        raise DeclarationError(f"number {text!r} not understood")
    return int(eval(plain.replace("/", "//"), {"__builtins__": {}}))
