"""What an operator types before a session, and the plan that it makes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from threading import Event

from app.measuring.indicators import (
    DEFAULT_PROFILE,
    asked_of,
    check_indicators,
    from_file,
    indicator_of,
    last_used,
    simulated_indicators,
)
from app.measuring.plan import Plan, session_name
from calib.errors import GlidecalError, IndicatorError, UsageError
from drivers.doctor import PortFinding, findings_of, refused, try_profiles
from drivers.profile import Evidence, Profile, Unit
from drivers.profiles import PROFILES
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
    ``fields`` are texts that follow from what was typed; its ``problem`` is that of the machine,
    ``forgotten`` why nothing is known of what was used last. ``answers`` tell which profiles fit
    at a port.
    """

    typed: Mapping[str, str] = field(default_factory=dict)
    forms: list[Form] = field(default_factory=lambda: [{}, {}])
    source: str = ""
    fields: dict[str, str] = field(default_factory=dict)
    problem: GlidecalError | None = None
    forgotten: GlidecalError | None = None
    answers: dict[str, str] = field(default_factory=dict)
    offered_for: Machine = field(default_factory=lambda: load_machine(None))
    _proposed_for: Machine | None = None
    _usual: str | None = None

    def retype(self, typed: Mapping[str, str]) -> None:
        """What the fields say now: the machine decides what can be measured, and with what."""
        self.typed, self.fields, self.problem, self.forgotten = typed, {}, None, None
        try:
            machine = self.machine()
            self._offer(machine)
            if machine != self._proposed_for and (self.source or not any(self.forms)):
                self._propose(machine)
        except GlidecalError as problem:
            self.problem = problem
        self.typed = {**typed, **self.fields}

    def machine(self) -> Machine:
        """Raises RecordError or UsageError for what is no machine."""
        typed = self.typed.get("machine")
        return load_machine(str(Path(typed).expanduser()) if typed else None)

    def _offer(self, machine: Machine) -> None:
        """Offer the machine's usual procedure, by hand or where a controller moves it, or the
        chosen one.
        """
        procedure = self.typed.get("procedure")
        procedure_before = self._usual or self.offered_for.usual_procedure
        self._usual = procedure_of(machine, moving=bool(self.typed["motion"]))
        self.offered_for = machine
        stays = procedure and procedure != procedure_before and procedure in self.procedures
        self.fields["procedure"] = procedure if procedure and stays else self._usual

    @property
    def procedures(self) -> list[str]:
        """What a guided session can measure on the machine, its usual procedure first."""
        machine = self.offered_for
        names = guided_procedure_names(machine.geometry(), machine.printable_radius_mm)
        return list(dict.fromkeys([machine.usual_procedure, *names]))

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
        """The chosen indicators. Raises UsageError where they do not fit the procedure."""
        instruments = tuple(indicator_of(form) for form in self.forms if form)
        if instruments:
            check_indicators(instruments, legs=bool(procedure.levels))
        return instruments

    def some_instruments(self, procedure: Procedure) -> tuple[Instrument, ...]:
        """The chosen indicators; without any, two."""
        return self.instruments(procedure) or simulated_indicators()

    def choose(self, number: int, form: Form) -> None:
        """An indicator; what was proposed is chosen from there on."""
        if form != self.forms[number]:
            self.forms[number], self.source = form, ""

    def _propose(self, machine: Machine) -> None:
        """The indicators of the machine file, else those used last; serial number and place.

        Raises UsageError where the file may not name a port.
        """
        self.forms, self.source = [{}, {}], ""
        proposals = {"file": from_file(machine.indicator, "the machine file")}
        self._proposed_for = machine
        try:
            last, name = last_used(), machine.name
            proposals["last"] = last.machines.get(name, ())
            self.fields["serial"] = machine.serial_number or last.serial_numbers.get(name, "")
            self.fields["place"] = machine.place or last.places.get(name, "")
        except GlidecalError as problem:
            self.forgotten = problem
        for source, instruments in proposals.items():
            if instruments and not self.source:
                forms = [entry.model_dump(mode="json", exclude_none=True) for entry in instruments]
                self.forms, self.source = [*forms, {}][:2], source

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
    usual, fields = USUAL | form, Instrument.model_fields
    changed = {
        n: text for n, text in typed.items() if n in fields and text != str(usual.get(n, ""))
    }
    left_out = OF_ITS_OWN if "profile" in changed else ()
    return {name: value for name, value in (form | changed).items() if name not in left_out}


class ProfileTrial:
    """The port of a form, asked as each profile does; ``fitting`` are those that fit, then.

    Raises UsageError or IndicatorError for what is no port.
    """

    def __init__(self, form: Form) -> None:
        asking = {name: form.get(name) for name in ("port", "channel", "unit")}
        self.instrument = indicator_of({"profile": DEFAULT_PROFILE, **asking})  # any: not asked for
        self.fitting: list[Profile] = []
        self._stopped = Event()

    def stop(self) -> None:
        """The next profile is not tried any more."""
        self._stopped.set()

    def run(self, progress: Callable[..., object]) -> list[PortFinding]:
        """Try them, up to a minute; nothing is found where it is stopped before one fits."""
        port, stopped = self.instrument.port, self._stopped.is_set
        query = asked_of(self.instrument)
        try:
            trials = try_profiles(
                PROFILES.values(), port, query, progress=progress, stopped=stopped
            )
        except IndicatorError as problem:
            return [refused(port, problem)]
        self.fitting = [profile for profile, _ in trials.fits]
        return findings_of(trials) if self.fitting or not stopped() else []

    def best(self, name: object) -> str:
        """The name of the profile to take: the chosen one if it fits, else one that is verified."""
        best = min(self.fitting, key=lambda profile: profile.verified is Evidence.UNVERIFIED)
        return str(name) if name in [profile.name for profile in self.fitting] else best.name


def _temperature(text: str) -> float | None:
    if not text:
        return None
    plain = text.replace(",", ".")
    if not NUMBER.fullmatch(plain) or not -50.0 <= float(plain) <= 100.0:
        raise UsageError("temperature", repr(text), "−50 … 100 °C, or nothing")
    return float(plain)
