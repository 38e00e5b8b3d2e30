"""What an operator types before a session, and the plan that it makes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path

from app.measuring.indicators import (
    check_indicators,
    form_of,
    from_file,
    indicator_of,
    last_identity,
    last_used,
    simulated_indicators,
)
from app.measuring.plan import Plan, session_name
from calib.errors import UsageError
from drivers.profile import Evidence, Profile, Unit
from protocols.data_table import NUMBER
from protocols.machine import Instrument, Machine, load_machine
from protocols.motion import procedure_of
from protocols.procedure import Procedure, guided_procedure_names, procedure_on, shuffled

Form = dict[str, object]
"""The values of an indicator by their names in the record, texts as typed; empty: none."""

AXES = ("xyz", *("".join(order) for n in (1, 2) for order in permutations("xyz", n)))
"""What an indicator may measure along, the preferred direction first."""

USUAL: Form = {"axes": "xyz", "unit": Unit.MM.value}
OF_ITS_OWN = ("pattern", "request", "resolution_mm", "repeatability_mm", "travel_mm")
"""What a file says of its indicator, and nothing of another one chosen in its place."""

SEED = re.compile(r"\d{1,9}", re.ASCII)


@dataclass
class Preparation:
    """``typed`` texts by field, and the ``forms`` of two indicators.

    ``source`` says where these were proposed from: "file", "last", or "" where they were chosen.
    """

    typed: Mapping[str, str] = field(default_factory=dict)
    forms: list[Form] = field(default_factory=lambda: [{}, {}])
    source: str = ""
    proposed_for: Machine | None = None
    offered_for: Machine = field(default_factory=lambda: load_machine(None))
    _usual: str | None = None

    def machine(self) -> Machine:
        """Raises RecordError or UsageError for what is no machine."""
        typed = self.typed.get("machine")
        return load_machine(str(Path(typed).expanduser()) if typed else None)

    def usual_procedure(self, machine: Machine) -> str:
        """By hand, or where a controller moves the machine."""
        return procedure_of(machine, moving=bool(self.typed["motion"]))

    def offer(self, machine: Machine) -> tuple[list[str], str]:
        """The procedures of a machine, and that of its usual one or the chosen one."""
        names, chosen = procedures_of(machine), self.typed.get("procedure", "")
        before = self._usual or self.offered_for.usual_procedure
        self._usual, self.offered_for = self.usual_procedure(machine), machine
        stays = chosen != before and chosen in names
        return names, chosen if stays else self._usual

    def procedure(self, machine: Machine) -> Procedure:
        """Shuffled where a seed is typed. Raises UsageError, RecordError."""
        procedure = procedure_on(machine, self.typed.get("procedure", ""))
        seed = self.typed["random"]
        if not seed:
            return procedure
        if not SEED.fullmatch(seed):
            raise UsageError("random order seed", repr(seed), "a whole number from 0, or nothing")
        return shuffled(procedure, int(seed))

    def instruments(self, procedure: Procedure) -> tuple[Instrument, ...]:
        """Those that are chosen. Raises UsageError where they do not fit the procedure."""
        instruments = tuple(indicator_of(form) for form in self.forms if form)
        if instruments:
            check_indicators(instruments, legs=bool(procedure.levels))
        return instruments

    def some_instruments(self, procedure: Procedure) -> tuple[Instrument, ...]:
        """The same; without any, two."""
        return self.instruments(procedure) or simulated_indicators()

    def choose(self, which: int, form: Form) -> None:
        """An indicator; what was proposed is chosen from there on."""
        if form != self.forms[which]:
            self.forms[which], self.source = form, ""

    def to_propose(self, machine: Machine) -> bool:
        """Whether another machine is named since, and no indicators were chosen."""
        return machine != self.proposed_for and (not any(self.forms) or bool(self.source))

    def propose(self, machine: Machine) -> None:
        """The indicators of the machine file. Raises UsageError where it may not name a port."""
        self.forms, self.source = [{}, {}], ""
        self._take(from_file(machine.indicator, "the machine file"), "file")
        self.proposed_for = machine

    def propose_last(self, machine: Machine) -> tuple[str, str]:
        """The indicators used last, where the file has none; serial number and place.

        Raises RecordError.
        """
        serial_number, place = last_identity(machine.name)
        if not self.source:
            self._take(last_used(machine.name), "last")
        return machine.serial_number or serial_number, machine.place or place

    def _take(self, instruments: Sequence[Instrument], source: str) -> None:
        if instruments:
            self.forms, self.source = [*map(form_of, instruments), {}][:2], source

    def rehearsal(self) -> Plan:
        """What would be measured; without any indicators, with two. Raises as `plan`."""
        machine = self.machine()
        procedure = self.procedure(machine)
        instruments = self.some_instruments(procedure)
        return Plan(Path(), machine, procedure, instruments, motion=self.typed["motion"] or None)

    def plan(self, without: str) -> Plan:
        """All of it. Raises UsageError, with the words ``without`` where no indicator is chosen."""
        names = {"serial_number": "serial", "place": "place"}
        identity = {key: self.typed[name] or None for key, name in names.items()}
        machine = self.machine().model_copy(update=identity)
        procedure = self.procedure(machine)
        instruments = self.instruments(procedure)
        if not instruments:
            raise UsageError("indicators", "none", "one or two", without)
        return Plan(
            path=session_name(Path(), procedure.name),
            machine=machine,
            procedure=procedure,
            instruments=instruments,
            operator=self.typed["operator"],
            temperature_c=_temperature(self.typed["temperature"]),
            note=self.typed["note"],
            motion=self.typed["motion"] or None,
        )


def retyped(form: Form, typed: Mapping[str, str]) -> Form:
    """The values of an indicator with those that were typed; what is usual need not stand in it."""
    usual = USUAL | form
    changed = {name: text for name, text in typed.items() if text != str(usual.get(name, ""))}
    left_out = OF_ITS_OWN if "profile" in changed else ()
    return {name: value for name, value in (form | changed).items() if name not in left_out}


def best_fit(fitting: Sequence[Profile], chosen: object) -> str:
    """The name of the profile to take: the chosen one if it fits, else one that is verified."""
    best = min(fitting, key=lambda profile: profile.verified is Evidence.UNVERIFIED)
    return str(chosen) if chosen in [profile.name for profile in fitting] else best.name


def procedures_of(machine: Machine) -> list[str]:
    """What a guided session can measure on this machine, its usual procedure first."""
    offered = guided_procedure_names(machine.geometry(), machine.printable_radius_mm)
    return list(dict.fromkeys([machine.usual_procedure, *offered]))


def _temperature(text: str) -> float | None:
    if not text:
        return None
    plain = text.replace(",", ".")
    if not NUMBER.fullmatch(plain) or not -50.0 <= float(plain) <= 100.0:
        raise UsageError("temperature", repr(text), "−50 … 100 °C, or nothing")
    return float(plain)
