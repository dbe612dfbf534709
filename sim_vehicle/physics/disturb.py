"""The disturbances in one sub-step. Compiled.

A disturbance is a row of numbers (sim_vehicle/world/world.py) and the function `act` of its class. Compiled code cannot
look a function up in a table, so `call_act` is a chain: each link calls its own function if the row has its number,
else the next link. The chain of the built-in disturbances is compiled once and cached. For a flight with a disturbance
of the user's own, `for_disturbances` compiles a longer chain and the functions that call it.
"""

from collections.abc import Callable
from functools import cache
from math import sqrt
from typing import Any, TypeVar

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.compiled import compiled, inlined, replaced
from sim_vehicle.world.catalogue import acting_classes
from sim_vehicle.world.interface import Disturbance

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


@inlined
def _end(
    number: float, v: Array, memory: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array
) -> None:
    """End of a chain."""


def _link(own: int, act: Any, rest: Any) -> Any:
    """A function that calls `act` for the number `own`, and `rest` for other numbers."""

    def link(
        number: float, v: Array, memory: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array
    ) -> None:
        if number == own:
            act(v, memory, time_s, state, P, noise, effect)
        else:
            rest(number, v, memory, time_s, state, P, noise, effect)

    return inlined(link)


def _chain(classes: tuple[type[Disturbance], ...]) -> Any:
    """A function that calls the `act` of a class by its number, which is its place among the classes."""
    call = _end
    for number, one in reversed(list(enumerate(classes))):
        call = _link(number, inlined(one.act), call)
    return call


BUILT_IN = acting_classes()
call_act = _chain(BUILT_IN)


@compiled
def disturb(state: Array, rows: Array, memories: Array, time_s: float, P: Array, noise: Array, effect: Array) -> None:
    """Write the air velocity into state[WIND], and air velocity, force, torque and voltage drop into effect.

    noise: [rows, NOISE_PER_ROW]. effect: [EFFECT_SIZE]. A nanosecond of slack covers rounding of the time.
    """
    for i in range(at.EFFECT_SIZE):
        effect[i] = 0.0
    for stage in range(at.LOAD + 1):
        if stage == at.TURBULENCE:
            n, e, d = effect[0] - state[3], effect[1] - state[4], effect[2] - state[5]
            effect[at.AIR_SPEED] = sqrt(n * n + e * e + d * d)
        elif stage == at.LOAD:
            for i in range(3):
                state[at.WIND + i] = effect[at.AIR + i]
        for j in range(rows.shape[0]):
            if rows[j, at.ROW_STAGE] == stage and rows[j, at.ROW_ONSET] <= time_s + 1.0e-9 < rows[j, at.ROW_END]:
                since_onset_s = time_s - rows[j, at.ROW_ONSET]
                v = rows[j, at.ROW_VALUES :]
                call_act(rows[j, at.ROW_NUMBER], v, memories[j], since_onset_s, state, P, noise[j], effect)


def for_disturbances(function: FunctionT, disturbances: tuple[Disturbance, ...]) -> FunctionT:
    """`function`, compiled for disturbances of these classes; itself if all of them are built in."""
    classes = acting_classes(disturbances)
    return function if classes == BUILT_IN else _for_classes(function, classes)


@cache
def _for_classes(function: FunctionT, classes: tuple[type[Disturbance], ...]) -> FunctionT:
    return replaced(function, call_act, _chain(classes))
