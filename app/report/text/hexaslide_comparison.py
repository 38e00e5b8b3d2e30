"""Two sessions of postures in words: whether their machine is the same."""

from __future__ import annotations

import math

from rich.table import Table

from app.evaluating.hexaslide import ComparedSession, ComparedSessions
from app.report.schema.hexaslide_diagnosis import LengthOfBoth, lengths_of
from app.report.text.hexaslide_diagnosis import verdict_words
from app.report.text.tables import paragraphs, result_table
from calib.hexaslide.comparison import CHANGED, MachinesApart

MOST_LENGTHS = 8
LEAST_SHOWN = 1e-6
"""Smaller chances are only such."""


def comparison_text(compared: ComparedSessions) -> str:
    """Whether the machine changed, by how much at the platform, and in which lengths."""
    apart = compared.apart
    laid_over = f"Laid over, for no reading shows it: {'; '.join(apart.free)}."
    return paragraphs(
        f"{compared.before.name} and {compared.after.name}: {_verdict(apart)}",
        _platform(apart),
        *_lengths(apart),
        "\n".join(_session(session) for session in (compared.before, compared.after)),
        laid_over if apart.free else "",
    )


def _verdict(apart: MachinesApart) -> str:
    if apart.p_value is None:
        return "not known whether the machine changed."
    p_words = (
        f"of {apart.p_value:.2g}" if apart.p_value >= LEAST_SHOWN else f"below {LEAST_SHOWN:g}"
    )
    chance = f"one machine would differ so much with a chance {p_words}"
    return f"the machine changed; {chance}." if apart.changed else f"no change shows; {chance}."


def _platform(apart: MachinesApart) -> str:
    text = (
        f"The platform, over the box: {1000.0 * apart.rms_m:.3g} mm r.m.s. from one to the other, "
        f"at most {1000.0 * apart.largest_m:.3g} mm."
    )
    if apart.chance_m is None:
        return (
            f"{text} A session has too few readings, leaves more open than frames, or has no "
            "known noise."
        )
    text += f" Noise alone gives up to {1000.0 * apart.chance_m:.3g} mm r.m.s. (95 %)."
    if apart.changed:
        text += f" The chance is below {CHANGED:g}: calibrate from the second session."
    return text


def _lengths(apart: MachinesApart) -> list[str | Table]:
    """Lengths that differ most by their uncertainty."""
    if apart.expanded_m is None:
        return []
    lengths = lengths_of(apart)
    times = {
        name: abs(d.difference_mm) / (d.expanded_mm or math.inf) for name, d in lengths.items()
    }
    beyond = [name for name in sorted(lengths, key=lambda n: (-times[n], n)) if times[name] > 1.0]
    least, most = 1000.0 * apart.expanded_m.min(), 1000.0 * apart.expanded_m.max()
    text = (
        f"{len(beyond)} of {len(lengths)} lengths that no frame changes differ by more than their "
        f"uncertainty, ±{least:.3g} to ±{most:.3g} mm (95 %)"
    )
    if not beyond:
        return [f"{text}."]
    listed = {name: lengths[name] for name in beyond[:MOST_LENGTHS]}
    together = "of one machine one in twenty does, and those of a joint go together"
    return [f"{text}; {together}.", result_table(LengthOfBoth, listed, "length")]


def _session(session: ComparedSession) -> str:
    """What stands against a session."""
    text = f"{session.name}: "
    if session.left_out:
        text += f"without posture {', '.join(map(str, session.left_out))}. "
    if session.diagnosis is None:
        return f"{text}no noise is stated; parameters alone are compared."
    return f"{text}{verdict_words(session.diagnosis)}"
