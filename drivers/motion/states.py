"""The states of a machine that a controller moves, and the one cause of each change between them.

``docs/motion.md`` draws this table; a test holds the drawing to it, and one test each to a row.
"""

from __future__ import annotations

from enum import StrEnum


class State(StrEnum):
    """What a machine may do now."""

    OFF = "off"
    """Nobody is connected."""
    READY = "ready"
    """At rest; nothing moves before the operator's consent."""
    CONSENTED = "consented"
    """At rest between moves that the operator consented to."""
    MOVING = "moving"
    STOPPING = "stopping"
    """A stop was sent; that the machine rests is not yet seen."""
    STOPPED = "stopped"
    """The operator stopped it, and it was seen to rest."""
    HELD = "held"
    """At rest; somebody or something else interfered, and the operator has not answered."""
    FAULT = "fault"
    """The controller cannot be used, and the operator has not answered."""


class Cause(StrEnum):
    """Why one state follows another."""

    CONNECTED = "connected, identified and ready"
    CONSENT = "the operator's consent"
    HOMING = "the operator's consent to homing"
    MOVE = "a move was sent"
    ARRIVED = "it arrived"
    RELEASED = "the consent ends"
    STOP = "a stop is wanted"
    RESTS = "it rests, stopped by the operator"
    RESTS_HELD = "it rests, stopped by something else"
    RESTS_FAULT = "it rests, stopped for a fault"
    VOUCHED = "the operator saw that it stands still"
    CHANGED = "somebody else changed something"
    FAILED = "a fault"
    ANSWERED = "the operator's answer, and it is ready"
    CLOSED = "closed"


TRANSITIONS: dict[tuple[State, Cause], State] = {
    (State.OFF, Cause.CONNECTED): State.READY,
    (State.OFF, Cause.FAILED): State.FAULT,
    (State.READY, Cause.CONSENT): State.CONSENTED,
    (State.STOPPED, Cause.CONSENT): State.CONSENTED,
    **{
        (state, Cause.HOMING): State.CONSENTED
        for state in (State.READY, State.STOPPED, State.FAULT)
    },
    (State.CONSENTED, Cause.MOVE): State.MOVING,
    (State.MOVING, Cause.ARRIVED): State.CONSENTED,
    (State.CONSENTED, Cause.RELEASED): State.READY,
    (State.CONSENTED, Cause.STOP): State.STOPPING,
    (State.MOVING, Cause.STOP): State.STOPPING,
    (State.STOPPING, Cause.RESTS): State.STOPPED,
    (State.STOPPING, Cause.RESTS_HELD): State.HELD,
    (State.STOPPING, Cause.RESTS_FAULT): State.FAULT,
    (State.STOPPING, Cause.VOUCHED): State.FAULT,
    **{(state, Cause.CHANGED): State.HELD for state in (State.READY, State.STOPPED)},
    **{
        (state, Cause.FAILED): State.FAULT
        for state in (State.READY, State.STOPPED, State.HELD, State.FAULT)
    },
    (State.HELD, Cause.ANSWERED): State.READY,
    (State.FAULT, Cause.ANSWERED): State.READY,
    **{(state, Cause.CLOSED): State.OFF for state in State},
}
"""Every other pair is refused: it changes nothing."""

MAY_MOVE = (State.CONSENTED, State.MOVING, State.STOPPING)
"""While it is in one of these every key stops it, and none does anything else."""

LOOKED_AT = (State.READY, State.CONSENTED, State.STOPPED)
"""At rest, and to be found as it was left."""
