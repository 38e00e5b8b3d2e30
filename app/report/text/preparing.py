"""Before the first reading in words: the procedure, its steps, which spindle is which."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from app.measuring.gauges import PushResult, SpindleCheck
from app.measuring.indicators import (
    indicator_words,
    moved_adapters,
    port_is_gone,
    profile_of,
    serial_ports,
)
from app.measuring.opening import PlanCheck
from app.measuring.plan import Plan
from app.measuring.preparation import AXES, USUAL, Form, Preparation
from app.measuring.simulated import short_travels
from app.report.text.home import (
    CHOOSE_INDICATOR,
    INDICATOR_FIELDS,
    NO_INDICATOR,
    NO_INDICATOR_AT_PLATE,
    FormField,
    axes_words,
    form_words,
    port_label,
    ports_here,
    profile_rows,
)
from app.report.text.session import cycle_words, mdi_line, visits_of
from app.report.text.tables import new_table, paragraphs
from calib.errors import GlidecalError
from calib.printable import with_capital
from calib.tripod.geometry import Geometry
from drivers.profile import Evidence, Unit
from protocols.machine import Instrument, Machine
from protocols.procedure import Procedure, Step


def procedure_sentence(procedure: Procedure, geometry: Geometry, axes: Sequence[str]) -> str:
    """Steps, time and kind of repeats of a procedure."""
    steps = len(procedure.steps(geometry, axes))
    indicators = len(axes) if procedure.levels else 1
    minutes = procedure.duration_s(geometry, axes) / 60.0
    in_place = procedure.repeats_in_place(geometry)
    repeats = "Every repeat approaches its posture again."
    if in_place:
        repeats = f"{in_place} repeats do not leave their posture: they show the indicator only."
    shuffled = ""
    if procedure.random_seed is not None:
        shuffled = f"Order shuffled in each cycle, seed {procedure.random_seed}."
    sentence = (
        f"{procedure.title}. {steps} steps with {indicators} indicator"
        f"{'s' if indicators > 1 else ''}, about {minutes:.0f} minutes."
    )
    return " ".join(filter(None, (sentence, procedure.description, repeats, shuffled)))


def indicator_fields(form: Form, names_by_port: Mapping[str, str]) -> Iterator[FormField]:
    """The form of an indicator, with what is known of it; ``names_by_port``: profiles by port."""
    values = {name: str(value) for name, value in (USUAL | form).items()}
    ports = [(port_label(*entry, names_by_port), entry[0]) for entry in serial_ports()]
    rows = {
        "profile": profile_rows(),
        "axes": [(axes_words(axes), axes) for axes in dict.fromkeys([*AXES, values["axes"]])],
        "unit": [(unit.value, unit.value) for unit in Unit],
    }
    yield FormField("here", "Ports here", ports_here(len(ports)), rows=ports)
    for field in INDICATOR_FIELDS:
        yield field._replace(value=values.get(field.name, ""), rows=rows.get(field.name))


def prepared_texts(prepared: Preparation) -> tuple[str, list[str]]:
    """What would be measured, what of the form is still missing or wrong, and `indicator_lines`."""
    parts, without, machine = [], NO_INDICATOR, prepared.offered_for
    if prepared.problem is not None:
        return str(prepared.problem), indicator_lines(prepared)
    try:
        procedure = prepared.procedure(machine)
        without = NO_INDICATOR if procedure.plate is None else NO_INDICATOR_AT_PLATE
        axes = [instrument.axes for instrument in prepared.some_instruments(procedure)]
        parts.append(procedure_sentence(procedure, machine.geometry(), axes))
        if any(prepared.forms):
            prepared.plan(CHOOSE_INDICATOR)
        else:
            parts.append(CHOOSE_INDICATOR)
    except GlidecalError as problem:
        parts.append(str(problem))
    return "\n".join(parts), indicator_lines(prepared, without)


def indicator_lines(prepared: Preparation, without: Sequence[str] = NO_INDICATOR) -> list[str]:
    """A line for each of both indicators, or what its absence means."""
    return [
        form_words(form, prepared.source, missing=port_is_gone(str(form.get("port", ""))))
        if form
        else label
        for form, label in zip(prepared.forms, without, strict=True)
    ]


def _short(procedure: Procedure, machine: Machine, instruments: Sequence[Instrument]) -> list[str]:
    """A paragraph for each indicator whose travel may not be enough."""
    return [
        f"Travel: {instrument.profile} moves up to {needed_mm:.1f} mm {where}, on a machine "
        "within its "
        f"tolerances; it has {instrument.travel_mm:g} mm. Take one with more travel, or smaller "
        "displacements."
        for instrument, needed_mm, where in short_travels(procedure, machine, instruments)
    ]


def dry_run_text(procedure: Procedure, machine: Machine, instruments: Sequence[Instrument]) -> str:
    """Every step of a procedure with the line to type at the controller."""
    geometry, axes = machine.geometry(), [instrument.axes for instrument in instruments]
    steps = procedure.steps(geometry, axes)
    repeated = {"leg", "station", "axes"} if procedure.plate else set()  # of every step
    columns = ("step", "leg", "posture", "cycle", "station", "axes", "controller")
    headings = [name for name in columns if name not in repeated]
    table = new_table(*headings, left_columns=len(headings))
    readers = instruments[: max(step.indicators.stop for step in steps)]
    names = [f"{k} {entry.profile} ({entry.port})" for k, entry in enumerate(readers, start=1)]
    order = " Axes are in this order." if len(names) > 1 else ""
    if procedure.plane is not None:
        order += " p: the stand is on the plane." + " 2: the second one reads." * (len(names) > 1)
    visits = visits_of(steps)
    for step in steps:
        place = (str(step.number), step.leg, step.posture(geometry), visits[step.number])
        station = f"p {step.station:g}" if step.over_plane else f"{step.station:g}"
        axes_words = f"{step.axes[0]} 2" if step.first else " ".join(step.axes)
        cells = (*place, station, axes_words, mdi_line(step, machine))
        table.add_row(
            *(entry for name, entry in zip(columns, cells, strict=True) if name not in repeated)
        )
    return paragraphs(
        procedure_sentence(procedure, geometry, axes),
        f"Indicators: {', '.join(names)}.{order}",
        *_short(procedure, machine, instruments),
        table,
    )


def rehearsal_text(options: str, plan: Plan, ports: Sequence[str]) -> str:
    """How a rehearsal is measured, with these ``options``, and moved."""
    connections = zip(plan.instruments, ports, strict=True)
    return (
        f"Measure with: glidecal run {options} "
        + " ".join(f"--indicator {instrument.profile}:{port}" for instrument, port in connections)
        + "\nHere Enter moves the machine to the next step, a number and Enter to that step; "
        "p1 and p2 push a spindle in. Ctrl-C ends."
    )


def rehearsed_text(step: Step, plan: Plan) -> str:
    """Where the machine goes."""
    geometry = plan.machine.geometry()
    posture, steps = step.posture(geometry), plan.procedure.steps(geometry, plan.axes)
    return f"step {step.number}: {step.touched}  {posture}  {cycle_words(step, steps)}"


def check_text(plan: Plan) -> str:
    """What to look at before the first reading, and which adapters are at another port."""
    if plan.simulated:
        check = "The machine is simulated. Its indicators send real bytes over real ports."
    else:
        check = "Compare: each display below must show what its indicator shows, in mm."
    unverified = [
        instrument.profile
        for instrument in plan.instruments
        if profile_of(instrument).verified is Evidence.UNVERIFIED
    ]
    if unverified:
        check += f"\nUNVERIFIED profile: {', '.join(unverified)}. Compare with the display first."
    sentence = procedure_sentence(plan.procedure, plan.machine.geometry(), plan.axes)
    begin = f"{{check.begin}} {'continues' if plan.continued else 'begins'} the session"
    if plan.continued:
        begin += "; after a break the indicators get a new zero"
    entered = ""
    if plan.before is not None:
        entered = "Verification: the exported offsets must now be in the controller.\n"
    return paragraphs(
        [f"WARNING: {line}" for line in adapter_lines(plan.instruments)],
        [f"{entered}{plan.machine.name}. {sentence}"],
        *_short(plan.procedure, plan.machine, plan.instruments),
        [check],
        [f"{begin}: {plan.path}"],
    )


OPENING = "Opening the indicators …"


def adapter_lines(instruments: Sequence[Instrument]) -> list[str]:
    """For each indicator whose adapter is at another port now, which."""
    return [
        f"{with_capital(indicator_words(k, instruments[k]))}: its adapter is at {port} now."
        for k, port in moved_adapters(instruments).items()
    ]


def refused_text(check: PlanCheck) -> str:
    """Why the indicators did not open; for those whose port has gone where they are now."""
    choose = "{check.port} chooses another port, " if check.absent else ""
    again = f"{choose}{{check.retry}} tries again, {{check.back}} goes back."
    return paragraphs([str(check.problem)], adapter_lines(check.plan.instruments), [again])


def trial_text(trial: SpindleCheck, step: Step) -> str:
    """Which spindle is to be pushed before ``step`` is measured, and what the last push told."""
    if trial.done:
        return "Each spindle was found at its place. {check.begin} begins."
    indicators = [indicator_words(k, instrument) for k, instrument in enumerate(trial.instruments)]
    first_name, second_name = indicators[trial.number_due], indicators[trial.number_due - 1]
    instrument = trial.instruments[trial.number_due]
    reads = trial.number_due in step.indicators
    axis = step.axes[step.indicators.index(trial.number_due)] if reads else instrument.axes[0]
    axis = f"along {axis.upper()}"
    findings = {
        PushResult.OTHER: f"{with_capital(second_name)} moved. Was it the one {axis}? Then "
        "{check.exchange} exchanges the ports. Else: ",
        PushResult.BOTH: "More than one moved. One at a time: ",
        PushResult.SIGN: f"Pushed in it reads {trial.last}, {instrument.pushed_in} is stated: "
        "turn its "
        "sign, or pushed_in in the machine file. Then: ",
    }
    where = "at the tool" if step.leg == "tool" else f"of {step.touched}"
    sentence = findings.get(trial.finding, "") + f"push in the spindle {axis} {where}"
    return f"{with_capital(sentence)} and let it go: {first_name}. {{check.begin}} begins without."
