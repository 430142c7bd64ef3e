"""Identified R(t) and L(t), with their verdict and its causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from . import _native

Verdict = Literal["pass", "refuse", "cannot_tell"]
Array = NDArray[np.float64]


class Finding(NamedTuple):
    """Remark on a capture, a sensor or a result; docs/identification.md has every code."""

    code: str
    severity: Literal["info", "warning", "error"]
    text: str
    value: float | None
    limit: float | None


class HalfCycle(NamedTuple):
    """Verdict on a mains half-cycle."""

    start: float
    """Zero crossing at which it begins, in seconds."""
    seen: float
    """Share of its middle 80 % that was captured."""
    verdict: Verdict
    why: list[str]


# Arrays have no one truth: results are equal to themselves alone (eq=False), here and in daemon.py.
@dataclass(frozen=True, eq=False)
class Law:
    """R and L over the amplitude of the current, one law of all half-cycles of a stretch, whatever the method."""

    i: Array
    """Amplitude of the current's fundamental in ampere."""
    R: Array
    """Resistance in ohm."""
    L: Array
    """Inductance in henry."""
    sigma_R: Array
    """Standard deviation of R in ohm."""
    sigma_L: Array
    """Standard deviation of L in henry."""
    chi2: float
    """Squared residual over what noise leaves."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """R(t) and L(t) of a stretch of one switching frequency."""

    method: str
    f_sw: float
    """Switching frequency in hertz."""
    error: str | None
    """Reason of a failure; the arrays are empty then."""
    t: Array
    """Time in seconds."""
    R: Array
    """Resistance of the fundamental in ohm."""
    L: Array
    """Inductance of the fundamental in henry."""
    sigma_R: Array
    """Standard deviation of R in ohm; NaN where the method states none."""
    sigma_L: Array
    """Standard deviation of L in henry; NaN where the method states none."""
    R_power: Array
    """P/I_rms² over all harmonics in ohm; NaN where the method does not separate them."""
    nmse_v: float | None
    """Error of the reconstructed voltage in percent."""
    nmse_i: float | None
    """Error of the reconstructed current in percent."""
    verdict: Verdict
    why: list[str]
    """Reasons of a verdict other than pass."""
    findings: list[Finding]
    """Findings, worst first."""
    half_cycles: list[HalfCycle]
    notes: list[str]
    """Limits that the method reached, parts that failed."""
    law: Law | None
    """R and L over the current, from all half-cycles of the stretch, whatever the method; `None` where there are fewer
    than two, or where R and L are not functions of the current alone."""

    @classmethod
    def _of(cls, outcome: _native.Outcome) -> Estimate:
        def column(values: Array) -> Array:
            return values if len(values) == len(outcome.t) else np.full(len(outcome.t), np.nan)

        return cls(
            method=outcome.method,
            f_sw=outcome.f_sw,
            error=outcome.error,
            t=outcome.t,
            R=outcome.R,
            L=outcome.L,
            sigma_R=column(outcome.sigma_R),
            sigma_L=column(outcome.sigma_L),
            R_power=column(outcome.R_power),
            nmse_v=outcome.nmse[0],
            nmse_i=outcome.nmse[1],
            verdict=cast(Verdict, outcome.verdict),
            why=outcome.why,
            findings=_findings(outcome.findings),
            half_cycles=[HalfCycle(a, b, cast(Verdict, c), d) for a, b, c, d in outcome.half_cycles],
            notes=outcome.notes,
            law=None if outcome.law is None else Law(*outcome.law),
        )


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of a method on a capture: its stretches, and the arrays of all of them in order of time."""

    estimates: list[Estimate]
    """One for each stretch of constant switching frequency."""
    warnings: list[Finding]
    """Remarks on the capture and its sensors, as the program prints them."""
    t: Array
    """Time in seconds."""
    R: Array
    """Resistance of the fundamental in ohm."""
    L: Array
    """Inductance of the fundamental in henry."""
    sigma_R: Array
    """Standard deviation of R in ohm; NaN where the method states none."""
    sigma_L: Array
    """Standard deviation of L in henry; NaN where the method states none."""
    f_sw: Array
    """Switching frequency in hertz."""

    @property
    def verdict(self) -> Verdict:
        """Verdict on all estimates together, as the program's exit status has it: the worst one; a stub beside a stretch that passes does
        not count, nor does a stretch on which the method failed."""
        return cast(Verdict, _native.overall_verdict([e.verdict for e in self.estimates if e.error is None]))

    @property
    def passed(self) -> bool:
        """True if R and L can be trusted."""
        return self.verdict == "pass"

    @property
    def why(self) -> list[str]:
        """Reasons of a verdict other than pass."""
        return [reason for estimate in self.estimates for reason in estimate.why]

    @property
    def findings(self) -> list[Finding]:
        """Findings on the results, each once."""
        return list(dict.fromkeys(f for estimate in self.estimates for f in estimate.findings))

    def __repr__(self) -> str:
        method = self.estimates[0].method
        return f"Identification({method}: {len(self.t)} points in {len(self.estimates)} stretches, {self.verdict})"

    @classmethod
    def _of(cls, outcomes: Sequence[_native.Outcome], remarks: Sequence[_native.RemarkTuple]) -> Identification:
        estimates = [Estimate._of(outcome) for outcome in outcomes]
        found = [estimate for estimate in estimates if estimate.error is None]
        if not found:
            raise _native.IdentifyError("; ".join(e.error or "" for e in estimates) or "nothing to identify")

        def joined(arrays: list[Array]) -> Array:
            return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)

        return cls(
            estimates=estimates,
            warnings=_findings(remarks),
            t=joined([e.t for e in found]),
            R=joined([e.R for e in found]),
            L=joined([e.L for e in found]),
            sigma_R=joined([e.sigma_R for e in found]),
            sigma_L=joined([e.sigma_L for e in found]),
            f_sw=joined([np.full(len(e.t), e.f_sw) for e in found]),
        )


def _findings(remarks: Sequence[_native.RemarkTuple]) -> list[Finding]:
    return [Finding(*remark) for remark in remarks]
