"""What the verbs answer: dataclasses with the names of the program's JSON.

Numbers are those of `radcam ... --json`, bit for bit. Each result has `json()` (the dictionary), `to_frame()` (a pandas table, where pandas is
there) and a form for Jupyter.
"""

from __future__ import annotations

import html
import json as _json
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

if TYPE_CHECKING:
    import pandas

Agreement = Literal["holds", "doubtful", "fails"]
_T = TypeVar("_T", bound="Result")


def _number(value: float | None) -> float:
    """JSON has no NaN: null is one."""
    return float("nan") if value is None else value


@dataclass(frozen=True)
class Quantity:
    """A value with its standard error and the unit of both; NaN where it is not known."""

    value: float
    std_err: float
    unit: str

    @classmethod
    def of(cls, d: dict[str, Any]) -> Quantity:
        """From the program's JSON."""
        return cls(_number(d["value"]), _number(d["std_err"]), d["unit"])

    def __str__(self) -> str:
        if not np.isfinite(self.std_err) or self.std_err <= 0:
            return f"{self.value:.6g} {self.unit}".strip()
        # Two digits of the error, and of the value as many.
        places = max(0, 1 - int(np.floor(np.log10(self.std_err))))
        return f"{self.value:.{places}f} ± {self.std_err:.{places}f} {self.unit}".strip()


@dataclass(frozen=True)
class Result:
    """Common to all results."""

    raw: dict[str, Any] = field(repr=False, compare=False)

    @classmethod
    def of_text(cls: type[_T], text: str) -> _T:
        """From the program's JSON as text."""
        return cls.of(_json.loads(text))

    @classmethod
    def of(cls: type[_T], d: dict[str, Any]) -> _T:
        """From the program's JSON."""
        raise NotImplementedError

    def json(self) -> dict[str, Any]:
        """The program's JSON, as a dictionary."""
        return self.raw

    def to_frame(self) -> pandas.DataFrame:
        """The table of this result; needs pandas."""
        import pandas

        return pandas.DataFrame(self._rows())

    def _rows(self) -> list[dict[str, Any]]:
        return [self.raw]

    def _title(self) -> str:
        return type(self).__name__

    def _plot(self) -> str:
        return ""

    def _repr_html_(self) -> str:
        rows = self._rows()
        columns = list(rows[0]) if rows else []

        def cell(value: Any) -> str:
            return html.escape(f"{value:.5g}" if isinstance(value, float) else "" if value is None else str(value))

        head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
        shown = rows if len(rows) <= 40 else rows[:20] + rows[-20:]
        body = "".join("<tr>" + "".join(f"<td>{cell(r.get(c))}</td>" for c in columns) + "</tr>" for r in shown)
        more = "" if len(rows) <= 40 else f"<p>40 of {len(rows)} rows</p>"
        return f"<p><b>{html.escape(self._title())}</b></p>{self._plot()}<table><tr>{head}</tr>{body}</table>{more}"


def _svg(draw: Any) -> str:
    """A plot as SVG; nothing where matplotlib is missing."""
    try:
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure
    except ImportError:
        return ""
    import io

    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    FigureCanvasSVG(figure)
    draw(figure.add_subplot())
    out = io.StringIO()
    figure.savefig(out, format="svg")
    text = out.getvalue()
    return text[text.index("<svg") :]


@dataclass(frozen=True)
class NoiseLevel:
    """One level of the photon-transfer plot."""

    set: int
    kind: str
    mean_dn: float
    var_dn2: float
    var_std_err_dn2: float
    z: float
    used: bool
    excluded_because: str | None


@dataclass(frozen=True)
class NoiseReport(Result):
    """Gain and constant noise (Section IV of Healey and Kondepudy 1994)."""

    gain_dn_per_e: Quantity
    constant_noise_var_dn2: Quantity
    read_noise_e: Quantity
    offset_dn: Quantity
    offset_source: str
    chi2: float
    dof: int
    q: float
    levels: list[NoiseLevel]
    notes: list[str]

    @classmethod
    def of(cls, d: dict[str, Any]) -> NoiseReport:
        level = lambda l: NoiseLevel(  # noqa: E731
            l["set"], l["kind"], _number(l["mean_dn"]), _number(l["var_dn2"]), _number(l["var_std_err_dn2"]),
            _number(l["z"]), l["used"], l.get("excluded_because"),
        )
        return cls(
            d, Quantity.of(d["gain_dn_per_e"]), Quantity.of(d["constant_noise_var_dn2"]), Quantity.of(d["read_noise_e"]),
            Quantity.of(d["offset_dn"]), d["offset_source"], _number(d["chi2"]), d["dof"], _number(d["q"]),
            [level(l) for l in d["levels"]], d["notes"],
        )  # fmt: skip

    def _rows(self) -> list[dict[str, Any]]:
        return list(self.raw["levels"])

    def _title(self) -> str:
        return f"gain {self.gain_dn_per_e}; constant noise {self.constant_noise_var_dn2}; read noise {self.read_noise_e}"

    def _plot(self) -> str:
        def draw(axes: Any) -> None:
            used = [l for l in self.levels if l.used]
            left_out = [l for l in self.levels if not l.used]
            mean, var = [l.mean_dn for l in used], [l.var_dn2 for l in used]
            axes.errorbar(mean, var, [l.var_std_err_dn2 for l in used], fmt="o", label="used")
            if left_out:
                axes.plot([l.mean_dn for l in left_out], [l.var_dn2 for l in left_out], "x", label="not used")
            if mean:
                x = np.array([0.0, max(mean)])
                axes.plot(x, self.gain_dn_per_e.value * x + self.constant_noise_var_dn2.value, label="eq. (41)")
            axes.set(xlabel="mean above the black level (DN)", ylabel="variance (DN²)")
            axes.legend()

        return _svg(draw)


@dataclass(frozen=True)
class Residual:
    """One statistic on frames that the fit did not use."""

    observable: str
    set: int | None
    measured: float
    predicted: float
    std_err: float
    z: float
    level_dn: float
    statistic: str
    meaning: str
    unit: str


@dataclass(frozen=True)
class Comparison(Result):
    """A model against a campaign: the RMS of all residuals in standard errors is 1 where they agree."""

    error: float
    p_value: float
    consistent: bool
    agreement: Agreement
    residuals: list[Residual]
    not_looked_at: list[str]

    @classmethod
    def of(cls, d: dict[str, Any]) -> Comparison:
        names = Residual.__dataclass_fields__
        residuals = [Residual(**{n: r[n] for n in names}) for r in d["residuals"]]
        return cls(d, d["error"], d["p_value"], d["consistent"], d["agreement"], residuals, d["not_looked_at"])

    def _rows(self) -> list[dict[str, Any]]:
        return list(self.raw["residuals"])

    def _title(self) -> str:
        return f"error {self.error:.3f}, p {self.p_value:.3g}: the model {self.agreement}"

    def _plot(self) -> str:
        def draw(axes: Any) -> None:
            statistics = sorted({r.statistic for r in self.residuals})
            for s in statistics:
                of = [r for r in self.residuals if r.statistic == s]
                axes.plot([r.level_dn for r in of], [r.z for r in of], ".", label=s)
            axes.axhspan(-2, 2, alpha=0.1)
            axes.set(xlabel="level (DN)", ylabel="residual (standard errors)")
            axes.legend(fontsize="xx-small", ncols=3)

        return _svg(draw)


@dataclass(frozen=True)
class Missing:
    """An effect that a campaign shows and the model lacks; `effect` is "unknown" where none of the catalogue explains it."""

    effect: str
    confidence: float
    #: Share of the misfit that goes with it.
    share: float
    #: Relative errors of gain, read noise and linearity where it is left out of account.
    cost: dict[str, float | None]
    error_drop: float
    parameters: dict[str, Quantity]
    form: str | None
    partial: bool
    nearest: list[str]
    tied_with: str | None
    evidence: list[str]


@dataclass(frozen=True)
class Remainder:
    """What is left once all names are in the model."""

    share: float
    error: float
    p_value: float
    largest: list[str]
    cost: dict[str, float | None]


@dataclass(frozen=True)
class Proposal:
    """A law for what no effect of the catalogue explains: `radcam effects new` makes an effect of it, `radcam model add --proposal` adds it."""

    #: Formula of each statistic that it changes, as a custom effect has them.
    formulas: dict[str, str]
    parameters: dict[str, Quantity]
    #: Named effects beside it; none where it stands in their place.
    beside: list[str]
    error_before: float
    error_after: float
    p_value: float
    text: str
    causes: list[str]
    next_measurement: str | None
    #: Relative errors of gain, read noise and linearity where it is left out of account.
    cost: dict[str, float | None]
    #: Share of the gain by which it may be off where a filter mixes pixels that share noise.
    gain_open_rel: float

    @classmethod
    def of(cls, d: dict[str, Any]) -> Proposal:
        parameters = {name: Quantity.of(q) for name, q in d["parameters"].items()}
        return cls(**{**d, "parameters": parameters})


@dataclass(frozen=True)
class Rung:
    """A rung of the ladder: the error once `added` (None: the starting model) was added."""

    added: str | None
    error: float
    p_value: float


@dataclass(frozen=True)
class Diagnosis(Result):
    """Which physical effect is missing, and how far the error falls once it is added."""

    verdict: str
    kind: Literal["describes", "named", "unknown"]
    consistent: bool
    error_before: float
    error_after: float
    missing: list[Missing]
    ladder: list[Rung]
    next_measurement: str | None
    notes: list[str]
    #: None where what is left is within the noise.
    remainder: Remainder | None = None
    #: With all effects in the model; None where the campaign does not determine it.
    gain_dn_per_e: Quantity | None = None
    read_noise_e: Quantity | None = None
    dark_current_e_per_s: Quantity | None = None
    #: The measurement that would tell the closest candidates apart, as a plan that `capture` takes.
    next_plan: str | None = None
    #: None where the catalogue explains what was measured.
    proposal: Proposal | None = None

    @classmethod
    def of(cls, d: dict[str, Any]) -> Diagnosis:
        missing = [
            Missing(
                m["effect"], m["confidence"], m["share"], m["cost"], m["error_drop"],
                {name: Quantity.of(q) for name, q in m["parameters"].items()},
                m.get("form"), m["partial"], m.get("nearest", []), m.get("tied_with"), m["evidence"],
            )
            for m in d["missing"]
        ]  # fmt: skip
        ladder = [Rung(r["added"], r["error"], r["p_value"]) for r in d["ladder"]]
        verdict = d["verdict"]
        return cls(
            d, verdict["sentence"], verdict["kind"], d["consistent"], d["error_before"], d["error_after"], missing, ladder,
            d["next_measurement"], d["notes"], d["remainder"] and Remainder(**d["remainder"]),
            d["gain_dn_per_e"] and Quantity.of(d["gain_dn_per_e"]),
            d["read_noise_e"] and Quantity.of(d["read_noise_e"]),
            d["dark_current_e_per_s"] and Quantity.of(d["dark_current_e_per_s"]),
            proposal=d["proposal"] and Proposal.of(d["proposal"]),
        )  # fmt: skip

    def with_plan(self, plan: str | None) -> Diagnosis:
        """With the plan of the next measurement."""
        return replace(self, next_plan=plan)

    @property
    def effects(self) -> list[str]:
        """Names of what is missing, strongest first."""
        return [m.effect for m in self.missing]

    def _rows(self) -> list[dict[str, Any]]:
        return [{"model": r.added and f"+ {r.added}" or "starting model", "error": r.error, "p": r.p_value} for r in self.ladder]

    def _title(self) -> str:
        return self.verdict

    def _plot(self) -> str:
        def draw(axes: Any) -> None:
            names = [r.added and f"+ {r.added}" or "starting model" for r in self.ladder]
            axes.barh(names, [r.error for r in self.ladder])
            axes.axvline(1, linestyle="--", color="black")
            axes.invert_yaxis()
            axes.set(xlabel="error (1 is agreement)")

        return _svg(draw)


@dataclass(frozen=True)
class Evaluation(Result):
    """A camera by EMVA 1288, with standard errors."""

    definitions: str
    quantities: dict[str, Quantity | None]
    saturation_signal_dn: float
    notes: list[str]

    @classmethod
    def of(cls, d: dict[str, Any]) -> Evaluation:
        quantities = {name: q and Quantity.of(q) for name, q in d["quantities"].items()}
        return cls(d, d["definitions"], quantities, _number(d["saturation_signal_dn"]), d["notes"])

    def _rows(self) -> list[dict[str, Any]]:
        none = {"value": None, "std_err": None, "unit": ""}
        return [{"quantity": name, **(q or none)} for name, q in self.raw["quantities"].items()]

    def _title(self) -> str:
        return f"EMVA 1288 ({self.definitions})"


@dataclass(frozen=True)
class FrameStatistics(Result):
    """The noise of frames of one level, each statistic with its standard error where it has one."""

    frames: int
    pixels: float
    mean_dn: float
    var_dn2: Quantity
    successive_dn2: Quantity
    row_var_dn2: float
    column_var_dn2: float
    spatial_var_dn2: float

    @classmethod
    def of(cls, d: dict[str, Any]) -> FrameStatistics:
        quantity = lambda v: Quantity(_number(v["value"]), _number(v["std_err"]), "DN^2")  # noqa: E731
        rows, columns = d["line_var_dn2"]
        means = d["frame_means"]
        return cls(
            d, d["frames"], d["pixels"], sum(means) / len(means), quantity(d["var"]), quantity(d["successive"]), rows,
            columns, d["spatial_var_dn2"],
        )  # fmt: skip

    def _rows(self) -> list[dict[str, Any]]:
        names = ("frames", "pixels", "mean_dn", "var_dn2", "successive_dn2", "row_var_dn2", "column_var_dn2", "spatial_var_dn2")
        return [{"statistic": n, "value": str(getattr(self, n))} for n in names]
