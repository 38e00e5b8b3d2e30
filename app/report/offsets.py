"""What is exported: identified parameters of one machine and where they come from."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from app.evaluating.correction import SessionCorrection
from app.evaluating.own_effects import known_effects
from app.evaluating.printer import PrinterChange
from app.evaluating.solution import LineParameter, SessionSolution, solve_files
from app.report.schema.solution import Offset
from app.report.text.caveats import caveats, caveats_of_view
from app.report.text.correction import BOUND, FRAME_WORDS, correction_lines, off_line, view_words
from app.version import program
from calib.errors import RecordError, UsageError
from calib.identify.solution import Method, Subset
from calib.posterior.correction import Holds, ToolOff
from calib.posterior.entered import offsets_beside
from calib.printable import one_line
from calib.quantity import rows
from calib.tripod.controller import ControllerJoints
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import MOVES_THE_TOOL, Model, StageEffect
from protocols.files import Contents
from protocols.machine import Frame, Machine
from protocols.model_file import ambiguity, ambiguous_effects, is_model, read_model_file, to_model

JOINT_OFFSETS = PARAMETER_NAMES[:3]

LEAST_MM = 1e-4
"""Less at the tool is nothing: no indicator of a workshop shows it."""

MINUTE = "%Y-%m-%d %H:%M %z"
"""How a time stands in a file, for people and for `app.exports.linuxcnc_ini`."""

DIGITS = 16
"""Of a digest: enough to tell any two sessions apart; glidecal validate shows all."""

NOT_KNOWN = "NOTE: the values are of a model file: it does not contain how well they are known."


@dataclass(frozen=True)
class Offsets:
    """Parameters in mm with their uncertainties (none where the source has none).

    ``cautions`` are the bound at the tool, what is not in the files, what else to know of the
    readings, one line each. ``model`` holds the parameters, and effects with them. ``controller``
    is what the controller holds now, None where nobody stated it; ``recorded`` is when the first
    record began, None where the source does not tell, ``measured`` when it was measured, in words.
    ``bound`` is the caution that states the bound at the tool. ``result`` is where it is
    from, None for a model file; with ``view`` one of its sets is written as it is, in place of the
    correction.
    """

    source: str
    machine: Machine
    parameters: dict[str, Offset]
    model: Model
    controller: ControllerJoints | None
    recorded: datetime | None = None
    measured: str = ""
    digests: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()
    lacks_fit: bool = False
    bound: str = ""
    result: SessionSolution | None = None
    view: bool = False

    @property
    def made(self) -> str:
        """When it was measured, the beginnings of the digests, the program's version."""
        if self.recorded is None:
            return ""
        digests = ", ".join(digest[:DIGITS] for digest in self.digests)
        return f"measured {self.measured}, digest {digests}, {program()}"

    @property
    def joint_offsets_mm(self) -> tuple[float, float, float]:
        """d_rho of joints x, y, z: true position = believed position + offset.

        Raises RecordError where one is not stated.
        """
        _all_stated(f"offsets of {self.source}", self.parameters)
        x, y, z = (self.parameters[name].value for name in JOINT_OFFSETS)
        return x, y, z

    @property
    def printer_change(self) -> PrinterChange | None:
        """All that the firmware of a printer is to hold, where the correction is written."""
        return self.result.printer_change if self.result and not self.view else None

    @property
    def lines(self) -> tuple[LineParameter, ...]:
        """Parameters of the drives' lines; a model file does not hold how well they are known."""
        return self.result.lines if self.result else ()

    @property
    def lengths_mm(self) -> dict[str, float]:
        """The leg length errors that are not zero."""
        names = [name for name in PARAMETER_NAMES[3:] if name in self.parameters]
        return {name: mm for name in names if (mm := self.parameters[name].value)}


@dataclass(frozen=True)
class Export:
    """The texts of the files to write, and what a person must know of them, as the files say."""

    files: Contents
    cautions: tuple[str, ...]


def moves_the_tool(model: Model) -> tuple[StageEffect, ...]:
    """Effects of the model that a controller would have to correct."""
    return tuple(effect for effect in model.effects if effect.stage in MOVES_THE_TOOL)


def for_controller(
    offsets: Offsets,
    holds: Holds,
    left_out: Sequence[StageEffect] = (),
    absent: Mapping[str, str] | None = None,
) -> Offsets:
    """What files are written from that hold this: the correction, with the bound of these files.

    A set that was asked for, and a model file, are written as they are, without the effects
    ``left_out`` that these files do not hold. ``absent`` as `ControllerCorrections.of` has it.
    The bound of a model file is that of the whole model, and no other can be worked out.
    """
    result = offsets.result
    if result is not None and not offsets.view:
        correction = result.corrections.of(holds, absent)
        return replace(
            offsets,
            parameters=entered_parameters(correction),
            model=correction.model,
            bound=bound_of_files(result, correction.off),
            cautions=tuple(
                map(one_line, (*correction_lines(result, correction), *offsets.cautions))
            ),
        )
    effects = offsets.model.effects
    missing_ids = [id(effect) for effect in left_out]  # two effects may be equal
    names = list(dict.fromkeys(effect.id for effect in effects if id(effect) in missing_ids))
    model = offsets.model.with_effects(tuple(e for e in effects if id(e) not in missing_ids))
    if result is None:
        return _offsets_of_model(offsets, model, holds, names)
    if not names:
        return offsets
    off = result.corrections.off(model)
    leaves = "the bound of the tool includes what that leaves"
    missing = f"not in these files: {', '.join(names)}; {leaves}"
    return with_bound(offsets, bound_of_files(result, off), missing)


def _offsets_of_model(offsets: Offsets, model: Model, holds: Holds, names: list[str]) -> Offsets:
    """A model file for a controller: joint offsets take over what they can of all else.

    ``model`` is without the effects of these ``names``, which the controller does not hold.
    """
    lengths_mm = model.parameters_mm[3:] if holds == "kinematics" else (0.0, 0.0, 0.0)
    if lengths_mm != model.parameters_mm[3:]:
        names.append("leg lengths")
    if not names:
        return offsets
    frame = offsets.machine.frame
    lengths_model = replace(model, parameters_mm=(0.0, 0.0, 0.0, *lengths_mm))
    offsets_mm, left_mm = offsets_beside(lengths_model, offsets.model, frame)
    values = (*offsets_mm.tolist(), *lengths_mm)
    stated = [name for name in PARAMETER_NAMES if name in JOINT_OFFSETS or holds == "kinematics"]
    missing = (
        f"not in these files: {', '.join(names)}; joint offsets take over a part, the rest leaves "
        f"{left_mm:.4f} mm r.m.s. at the tool, {FRAME_WORDS[frame]}, if the model is right"
    )
    changed = replace(
        offsets,
        parameters=dict(zip(stated, map(Offset, values), strict=False)),
        model=replace(model, parameters_mm=values),
    )
    return with_bound(changed, "", missing)


def with_bound(offsets: Offsets, bound: str, *more: str) -> Offsets:
    """The offsets with the bound of the files in the place of that before, and further cautions."""
    other_texts = [text for text in offsets.cautions if text != offsets.bound]
    return replace(offsets, bound=bound, cautions=tuple(filter(None, [*more, bound, *other_texts])))


def bound_of_files(result: SessionSolution, off: ToolOff) -> str:
    """The caution that states what the tool is off by with what the files hold."""
    return one_line(off_line(result.frame, result.corrections.off_now, off))


def entered_parameters(correction: SessionCorrection) -> dict[str, Offset]:
    """d_rho and d_L of a correction; how well they are known, where offsets are entered alone."""
    names = [name for name in correction.values if name in PARAMETER_NAMES]
    values = {name: correction.values[name].value for name in names}
    if correction.uncertainties_mm is None:
        return {name: Offset(values[name]) for name in names}
    standard_mm, expanded_mm = (column.tolist() for column in correction.uncertainties_mm)
    # a few unlikely models widen u more than the interval: then their ratio is below 1.96
    return {
        name: Offset(values[name], u, wide, wide / u)
        for name, u, wide in zip(names, standard_mm, expanded_mm, strict=True)
    }


def offsets_from_result(result: SessionSolution, *, view: bool = False) -> Offsets:
    """What is exported of sessions; with ``view`` the set of parameters that is shown."""
    machine = result.sessions[0].opened.machine
    offsets = Offsets(
        source=", ".join(result.names),
        machine=machine,
        parameters={},
        model=Model(machine.geometry()),
        controller=_stated(machine),
        recorded=min(session.opened.at for session in result.sessions),
        measured=result.sessions[-1].opened.measured_words(MINUTE),
        digests=tuple(session.digest for session in result.sessions),
        cautions=tuple(map(one_line, caveats(result))),
        result=result,
        view=view,
    )
    if not view:
        return offsets
    solution = result.solution
    bound = bound_of_files(result, result.corrections.off(solution.model))
    return replace(
        offsets,
        parameters=rows(
            Offset,
            solution.names,
            solution.values_mm,
            solution.uncertainty_mm,
            solution.expanded_mm,
            solution.coverage_factors,
            solution.inflated_expanded_mm,
            solution.expanded_with_tolerances_mm,
        ),
        model=solution.model,
        cautions=(
            bound,
            one_line(view_words(result)),
            *offsets.cautions,
            *map(one_line, caveats_of_view(result)),
        ),
        lacks_fit=solution.lacks_fit,
        bound=bound,
    )


def _stated(machine: Machine) -> ControllerJoints | None:
    """What the machine file says that the controller holds."""
    home = machine.home_at_mm()
    return ControllerJoints.homed_at(home, machine.joints) if home else None


def offsets_from_files(
    paths: Sequence[Path],
    subset: Subset | None,
    method: Method,
    model: Path | None = None,
    frame: Frame | None = None,
) -> Offsets:
    """What is exported of sessions or a model file; an unfinished session is a caution, too.

    With a model its effects are fitted to the sessions, too. A subset, and what the linear method
    gives, is written as it is, in place of the correction.

    Raises RecordError where a file is neither, UsageError for a model with other options and for
    sessions between which the machine or its controller was changed, NotIdentifiable where they
    give no result.
    """
    view = subset is not None or method != "exact"
    if len(paths) == 1 and is_model(paths[0]):
        if view or model or frame:
            raise UsageError(
                "--subset, --method, --model or --frame",
                f"model {paths[0]}",
                "sessions: an export of a model has its own values",
            )
        return _offsets_from_model(paths[0])
    result = solve_files(paths, subset=subset, method=method, model=model, frame=frame)
    offsets = offsets_from_result(result, view=view)
    return replace(offsets, cautions=(*map(one_line, result.warnings), *offsets.cautions))


def _offsets_from_model(path: Path) -> Offsets:
    model_file = read_model_file(path)
    model = to_model(model_file, f"model {path}", known_effects())
    _all_stated(f"model {path}, parameters_mm", model_file.parameters_mm)
    names = [name for name in PARAMETER_NAMES if name in model_file.parameters_mm]
    unsure = ambiguous_effects(model_file)
    provenances = [effect.provenance for effect in model_file.effects if effect.provenance]
    cautions = [NOT_KNOWN, ambiguity(unsure), *(model_file.cautions or ())]
    recorded = max((p.measured for p in provenances if p.measured), default=None)
    return Offsets(
        source=path.name,
        machine=model_file.machine,
        parameters={name: Offset(model_file.parameters_mm[name]) for name in names},
        model=model,
        controller=_stated(model_file.machine),
        recorded=recorded,
        measured="" if recorded is None else format(recorded, MINUTE),
        digests=tuple(dict.fromkeys(digest for p in provenances for digest in p.digests)),
        cautions=tuple(dict.fromkeys(filter(None, cautions))),
        bound=next((caution for caution in cautions if caution.startswith(BOUND)), ""),
    )


def _all_stated(thing: str, names: Container[str]) -> None:
    missing = [name for name in JOINT_OFFSETS if name not in names]
    if missing:
        raise RecordError(
            thing,
            f"no {' and no '.join(missing)}",
            ", ".join(JOINT_OFFSETS) + ": an offset that is not stated is not 0",
            "Identify the joint offsets, or state every one of them.",
        )
