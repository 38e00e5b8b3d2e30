"""Printers through the program, beside what firmware fits and beside who knows how they are made.

Two columns are of the best that any evaluation of these contacts can do, to first order: one knows
the law of its row, one only that it is one of all these rows. In brackets with a turn about the
vertical free, which no contact shows and no print minds.

    python -m tests.blind.beside_firmware [--each 30] [--count 200] [--seed 1]
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path

import numpy as np

from tests.app.exports.upright_towers import rms
from tests.blind.plates import CYCLES, Knowing, heights, prior_of, slopes, tool
from tests.blind.printers import CASES, FloatArray, any_printer, calibrated, contacts, turn_free


def mean_square_root(values: list[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


def cell(values: list[float], turned: list[float]) -> str:
    return f"{mean_square_root(values):.4f} ({mean_square_root(turned):.4f})"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--each", type=int, default=30, help="printers of each case")
    parser.add_argument("--count", type=int, default=60, help="printers of which each part is off")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    slopes_of_parts = slopes(heights(0.0, math.inf)), slopes(tool)
    cases = {**CASES, "any": any_printer}
    priors = {name: prior_of(make) for name, make in cases.items()}
    print("| hidden | before | six | nine | glidecal | knows its law | knows all laws | kept |")
    for name, make in cases.items():
        knowing = (
            Knowing([priors[name]], *slopes_of_parts),
            Knowing([*priors.values()], *slopes_of_parts),
        )
        results, limits = [], []
        count = options.count if name == "any" else options.each
        for k in range(count):
            random = np.random.default_rng([options.seed, k, len(name)])
            parts = make(random)
            before = random.bit_generator.state
            contacts_mm = np.array(contacts(parts, random))[:, 2].reshape(CYCLES, -1).mean(axis=0)
            limits.append([knowledge.left_mm(parts, contacts_mm) for knowledge in knowing])
            random.bit_generator.state = before
            with tempfile.TemporaryDirectory() as folder:
                results.append(calibrated(parts, random, Path(folder)))
        if not results:
            continue
        columns = [
            cell([getattr(r, who) for r in results], [float(r.turned[number]) for r in results])
            for number, who in enumerate(("before", "six", "nine", "ours"))
        ]
        for number in range(len(knowing)):
            remaining: list[FloatArray] = [limit[number] for limit in limits]
            columns.append(cell([*map(rms, remaining)], [*map(turn_free, remaining)]))
        within_bound = sum(r.touched <= r.bound for r in results)
        bound = mean_square_root([r.bound for r in results])
        print(
            f"| {name} | {' | '.join(columns)} | {bound:.3f}, {within_bound} of {count} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
