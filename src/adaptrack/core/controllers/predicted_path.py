"""Commands that still wait for the dead time to pass, and the angle of the wheels behind a first-order lag.

A law that predicts from the end of the dead time starts where its pose was measured and lets the commands sent since
then act. Counted backwards from the end, the j-th latest command acts from j periods before it to j - 1 before it; the
start lies `behind` periods before it, which need not be whole.
"""

from __future__ import annotations

import math

from ..kernel import inlined, record, size_of, viewer
from ..maths.bits import whole
from ..maths.exact import ceil
from ..maths.exponential import exp
from .contract import MIN_LAW_SPEED, path_at

Wheels = record("Wheels", ("started", "angle"))
"""What is remembered begins with: 1 after the first step, the wheel angle (rad) at the start."""
wheels_of = viewer(Wheels)
SENT = size_of(Wheels)
"""Place of the commands (rad) behind it, the latest first."""


def size(behind: float) -> int:
    """How many numbers are remembered; two commands at least."""
    return SENT + math.ceil(behind) + 2


@inlined
def lagged(angle, command, time, lag):
    """The wheel angle (rad) after a time (s) under a command (rad)."""
    return command + (angle - command) * exp(-time / lag) if lag > 0.0 else command


@inlined
def count_pieces(behind):
    """How many commands act between start and end."""
    return whole(ceil(behind))


@inlined
def part_of(first, behind, memory):
    """The part of a memory, from a place on, that holds wheels and commands, `size` numbers."""
    return memory[first : first + SENT + 2 + count_pieces(behind)]


@inlined
def share_of(piece, behind):
    """For which share of a period the `piece`-th latest command acts behind the start: the oldest one may for less."""
    return min(behind - (piece - 1.0), 1.0)


@inlined
def sent(piece, memory):
    """The `piece`-th latest command (rad)."""
    return memory[SENT + piece - 1]


@inlined
def take_command(command, behind, period, lag, memory):
    """Remember the last command (rad); move the start, and the wheel angle there, on by a period."""
    wheels = wheels_of(memory, 0)
    if wheels.started == 0.0:
        wheels.started, wheels.angle = 1.0, command
        for j in range(SENT, memory.size):
            memory[j] = command
        return
    for j in range(memory.size - 1, SENT, -1):
        memory[j] = memory[j - 1]
    memory[SENT] = command
    oldest = count_pieces(behind)
    share = share_of(oldest, behind) if oldest > 0 else 1.0
    wheels.angle = lagged(wheels.angle, memory[SENT + oldest], share * period, lag)
    if oldest > 0:
        wheels.angle = lagged(wheels.angle, sent(oldest, memory), (1.0 - share) * period, lag)


@inlined
def curvature_at(distance, reference, road, s, p):
    """The curvature (1/m) of the path, so far (m) ahead; 0 of y_ref(t) for a car that hardly moves."""
    if road.line.start.size == 0 and s.speed < MIN_LAW_SPEED:
        return 0.0
    v = max(s.speed, MIN_LAW_SPEED)
    return path_at(reference, road, distance / v, v, p.period).curvature
