"""Many campaigns of many cameras: a table of verdicts, gains, noise, K and what changes, made by Dask on any cluster.

Results are Parquet files below one folder, `camera=SERIAL/date=YYYY-MM-DD/CAMPAIGN.parquet`, one for each campaign. A campaign whose file is there
is not measured again unless its frames' list, the model or radcam's version has changed, so that a run that was ended goes on where it was.

>>> from radcam import fleet
>>> found = fleet.run(["a/campaign", "b/campaign"], "results")  # doctest: +SKIP
>>> found.table()[["camera", "effect", "gain_dn_per_e"]]  # doctest: +SKIP
>>> found.outliers("gain_dn_per_e")  # doctest: +SKIP
"""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import pathlib
import sys
import tempfile
import urllib.parse
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import radcam

if TYPE_CHECKING:
    import pandas
    import pyarrow
    from distributed import Client
    from matplotlib.axes import Axes

#: Columns of the table with their Arrow types and meanings. `camera` and `date` are the partition's, and in its path.
SCHEMA: dict[str, tuple[str, str]] = {
    "campaign": ("string", "path of the dataset"),
    "camera": ("string", "serial number; the folder's name where the dataset has none"),
    "date": ("string", "day, YYYY-MM-DD"),
    "vendor": ("string", "maker"),
    "model": ("string", "model name: cameras of one model are siblings"),
    "key": ("string", "digest of what was measured, with what: the same key is not measured again"),
    "radcam": ("string", "version"),
    "error": ("string", "why there are no results; null where there are"),
    "verdict": ("string", "describes, named or unknown"),
    "effect": ("string", "what is missing most; null where nothing is"),
    "confidence": ("double", "its share of the evidence"),
    "sentence": ("string", "the verdict in words"),
    "error_before": ("double", "RMS of the residuals under the model that was given, in standard errors"),
    "error_after": ("double", "the same with what was found"),
    "gain_dn_per_e": ("double", "A, DN/e"),
    "gain_std_err": ("double", "its standard error, DN/e"),
    "constant_noise_var_dn2": ("double", "sigma_C^2, DN^2"),
    "constant_noise_std_err": ("double", "its standard error, DN^2"),
    "read_noise_e": ("double", "read noise, e"),
    "read_noise_std_err": ("double", "its standard error, e"),
    "offset_dn": ("double", "black level at zero exposure, DN"),
    "offset_std_err": ("double", "its standard error, DN"),
    "k_std": ("double", "standard deviation of K over the pixels; null where no calibration can be made"),
    "k_std_err": ("double", "standard error of K of a pixel"),
    "defects": ("int64", "hot, dead and unstable pixels"),
    "seconds": ("double", "time that the campaign took, s"),
    "bytes": ("int64", "bytes of its files"),
}


@dataclass(frozen=True)
class Campaign:
    """A dataset, and what its own files do not say. `date` without a value: the day on which the dataset was written."""

    path: str
    camera: str | None = None
    date: str | None = None

    def __post_init__(self) -> None:
        if self.date is not None:
            try:
                day = datetime.date.fromisoformat(self.date).isoformat()
            except ValueError:
                day = None
            if day != self.date:
                raise ValueError(f"{self.path}: date is {self.date!r}; write YYYY-MM-DD")


def _files(path: pathlib.Path) -> list[pathlib.Path]:
    return sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]


def _key(campaign: Campaign, model: str | None) -> str:
    """Changes with the list of frames and their sizes and times, the model, the version."""
    path = pathlib.Path(campaign.path)
    digest = hashlib.sha256(json.dumps([radcam.__version__, str(path.absolute()), campaign.camera, campaign.date]).encode())
    if model is not None:
        is_file = os.path.exists(model)
        digest.update(pathlib.Path(model).read_bytes() if is_file else model.encode())
    for file in _files(path):
        if file.exists():
            about = file.stat()
            digest.update(f"{file} {about.st_size} {about.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def _head(campaign: Campaign) -> dict[str, Any]:
    """What is known before anything is measured."""
    path = pathlib.Path(campaign.path)
    row: dict[str, Any] = dict.fromkeys(SCHEMA)
    row.update(campaign=str(path.absolute()), radcam=radcam.__version__, camera=campaign.camera or path.absolute().parent.name or "unknown")
    day = campaign.date
    if day is None and path.exists():
        day = datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.timezone.utc).date().isoformat()
    row["date"] = day or "unknown"
    return row


def measure(campaign: Campaign, model: str | None = None) -> dict[str, Any]:
    """One row of the table. What cannot be measured is named in `error`, and raises nothing."""
    import time

    begun = time.perf_counter()
    row = _head(campaign)
    try:
        row["key"] = _key(campaign, model)
        dataset = radcam.Dataset(campaign.path)
        about = dataset.manifest["camera"]
        row.update(vendor=about.get("vendor", ""), model=about.get("model", ""))
        row["camera"] = campaign.camera or about.get("serial") or row["camera"]
        row["bytes"] = sum(f.stat().st_size for f in _files(pathlib.Path(campaign.path)))
        noise = radcam.noise(campaign.path)
        for name, quantity, error in (
            ("gain_dn_per_e", noise.gain_dn_per_e, "gain_std_err"),
            ("constant_noise_var_dn2", noise.constant_noise_var_dn2, "constant_noise_std_err"),
            ("read_noise_e", noise.read_noise_e, "read_noise_std_err"),
            ("offset_dn", noise.offset_dn, "offset_std_err"),
        ):
            row[name], row[error] = quantity.value, quantity.std_err
        found = radcam.diagnose(campaign.path, model)
        row.update(verdict=found.kind, sentence=found.verdict, error_before=found.error_before, error_after=found.error_after)
        if found.missing:
            row.update(effect=found.missing[0].effect, confidence=found.missing[0].confidence)
        row.update(_k(dataset, campaign.path))
    except OSError as e:
        row["error"] = str(e)
    except Exception as e:
        row["error"] = f"{type(e).__name__}: {e}"
    row["seconds"] = time.perf_counter() - begun
    return row


def _k(dataset: radcam.Dataset, path: str) -> dict[str, Any]:
    """K in a few numbers, where the campaign has flats enough for it."""
    configurations = {s.configuration for s in dataset.sets if s.kind == "flat"}
    estimator = "joint" if len(configurations) >= 3 else "smooth"
    with tempfile.TemporaryDirectory() as folder:
        try:
            made = radcam.calibrate(path, os.path.join(folder, "cal.tiff"), estimator)
        except radcam.CalibrateError:
            return {}
        k = made.k
        return {
            "k_std": float(k.std(dtype=np.float64)),
            "k_std_err": float(np.mean(made.k_std_err, dtype=np.float64)),
            "defects": int(np.count_nonzero(made.defects)),
        }


def schema() -> pyarrow.Schema:
    """The table's schema, with each column's meaning as metadata."""
    import pyarrow

    kinds = {"string": pyarrow.string(), "double": pyarrow.float64(), "int64": pyarrow.int64()}
    return pyarrow.schema([pyarrow.field(name, kinds[kind], metadata={"meaning": text}) for name, (kind, text) in SCHEMA.items()])


def _safe(text: str) -> str:
    """A name of a folder: what a path or a partition cannot hold is written as %XX, as in an address."""
    return urllib.parse.quote(text, safe="") or "unknown"


def _write(to: pathlib.Path, row: dict[str, Any], there: dict[str, list[pathlib.Path]]) -> None:
    """Writes a row aside and puts it in place; earlier ones of the same campaign (`there`, by name of the file) go."""
    import pyarrow
    import pyarrow.parquet

    name = hashlib.sha256(row["campaign"].encode()).hexdigest()[:16] + ".parquet"
    folder = to / f"camera={_safe(row['camera'])}" / f"date={_safe(row['date'])}"
    folder.mkdir(parents=True, exist_ok=True)
    inside = schema()
    for column in ("camera", "date"):
        inside = inside.remove(inside.get_field_index(column))
    table = pyarrow.Table.from_pylist([{k: v for k, v in row.items() if k not in ("camera", "date")}], inside)
    aside = folder / f".{name}.{os.getpid()}"
    pyarrow.parquet.write_table(table, aside)
    os.replace(aside, folder / name)
    for other in there.pop(name, []):
        if other != folder / name:
            other.unlink(missing_ok=True)


def run(
    campaigns: Iterable[str | os.PathLike[str] | Campaign],
    to: str | os.PathLike[str],
    *,
    cluster: str | Client | None = None,
    workers: int | None = None,
    model: str | None = None,
    retry_failed: bool = True,
    progress: bool = False,
) -> Fleet:
    """Measures campaigns on a cluster and keeps the results below `to`.

    `cluster`: the address of a Dask scheduler, or a client; None starts one on this machine with `workers` processes (one for each processor). The
    workers must see the datasets under the same paths. Campaigns that fail are named in the column `error` and measured again at the next run
    (`retry_failed`); they do not stop the others. A worker that dies loses nothing: what it had is given to another.
    """
    from distributed import Client, LocalCluster, as_completed

    to = pathlib.Path(to)
    to.mkdir(parents=True, exist_ok=True)
    all_of = [c if isinstance(c, Campaign) else Campaign(os.fspath(c)) for c in campaigns]
    there: dict[str, list[pathlib.Path]] = {}
    for file in to.glob("camera=*/date=*/*.parquet"):
        there.setdefault(file.name, []).append(file)
    known = _known(Fleet(to).table(), retry_failed) if there else {}
    todo = [c for c in all_of if known.get(str(pathlib.Path(c.path).absolute())) != _key(c, model)]
    if not todo:
        return Fleet(to)
    own = None
    if isinstance(cluster, Client):
        client = cluster
    elif cluster is not None:
        client = Client(cluster)
    else:
        count = min(workers or os.cpu_count() or 1, len(todo))
        threads = max(1, (os.cpu_count() or 1) // count)
        # One campaign at a time on each: radcam's own threads share the processors.
        own = LocalCluster(
            n_workers=count, threads_per_worker=1, dashboard_address=None, env={"RAYON_NUM_THREADS": str(threads)}
        )
        client = Client(own)
    bar = _bar(len(todo)) if progress else None
    try:
        # A campaign at which workers die by themselves is given up after three: it is what kills them.
        futures = {client.submit(measure, c, model, pure=False, retries=3): c for c in todo}
        for future in as_completed(list(futures)):
            campaign = futures[future]
            try:
                # Waits where a worker died with a result that nobody had fetched: it is computed again.
                row = future.result()
            except Exception as error:
                row = {**_head(campaign), "error": f"{type(error).__name__}: {error}"}
                row["key"] = _key(campaign, model)
            _write(to, row, there)
            # The scheduler forgets it.
            future.release()
            if bar is not None:
                bar.update()
    finally:
        if bar is not None:
            bar.close()
        if client is not cluster:
            client.close()
        if own is not None:
            own.close()
    return Fleet(to)


def _known(table: pandas.DataFrame, retry_failed: bool) -> dict[str, str]:
    done = table[table["error"].isna()] if retry_failed else table
    return dict(zip(done["campaign"], done["key"], strict=True))


def _bar(total: int) -> Any:
    try:
        from tqdm.auto import tqdm
    except ImportError:
        print(f"{total} campaigns", file=sys.stderr)
        return None
    return tqdm(total=total, desc="campaigns")


#: The cameras that are far from their siblings of one model, as SQL of DuckDB: the median of the model, its scatter from the median absolute
#: deviation (which a few outliers leave alone), and the campaign's own standard error.
OUTLIERS = """
WITH campaigns AS (
    SELECT * FROM read_parquet('{folder}/camera=*/date=*/*.parquet', hive_partitioning = true, hive_types_autocast = false)
    WHERE {column} IS NOT NULL AND isfinite({column})
), siblings AS (
    SELECT model, median({column}) AS middle, mad({column}) / 0.6745 AS scatter FROM campaigns GROUP BY model
)
SELECT camera, date, campaign, model, {column}, middle,
    ({column} - middle) / sqrt(scatter * scatter + {error} * {error}) AS sigma
FROM campaigns JOIN siblings USING (model)
WHERE abs({column} - middle) > {sigma} * sqrt(scatter * scatter + {error} * {error})
ORDER BY abs(sigma) DESC
"""

#: Standard errors of the columns that have one.
_ERRORS = {
    "gain_dn_per_e": "gain_std_err",
    "constant_noise_var_dn2": "constant_noise_std_err",
    "read_noise_e": "read_noise_std_err",
    "offset_dn": "offset_std_err",
}


def _number(column: str) -> None:
    numbers = [name for name, (kind, _) in SCHEMA.items() if kind != "string"]
    if column not in numbers:
        raise ValueError(f"no column of numbers {column!r}; there are {', '.join(numbers)}")


class Fleet:
    """What was found, below a folder."""

    def __init__(self, folder: str | os.PathLike[str]):
        self.folder = pathlib.Path(folder)

    def _there(self) -> list[str]:
        found = sorted(str(p) for p in self.folder.glob("camera=*/date=*/*.parquet"))
        if not found:
            raise FileNotFoundError(f"{self.folder} holds no results; `run` makes them")
        return found

    def table(self) -> pandas.DataFrame:
        """All campaigns, by camera and date."""
        import pyarrow
        import pyarrow.dataset

        files = self._there()
        partition = pyarrow.dataset.partitioning(
            pyarrow.schema([("camera", pyarrow.string()), ("date", pyarrow.string())]), flavor="hive"
        )
        found = pyarrow.dataset.dataset(
            files, schema=schema(), partitioning=partition, partition_base_dir=str(self.folder), format="parquet"
        )
        table: pandas.DataFrame = found.to_table().to_pandas()
        return table.sort_values(["camera", "date", "campaign"], ignore_index=True)

    def failed(self) -> pandas.DataFrame:
        """Campaigns without results, and why."""
        table = self.table()
        return table[table["error"].notna()][["campaign", "camera", "error"]]

    def outliers_sql(self, column: str = "gain_dn_per_e", sigma: float = 4.0) -> str:
        """The query of `outliers`, for DuckDB."""
        _number(column)
        folder = str(self.folder).replace("'", "''")
        return OUTLIERS.format(folder=folder, column=column, error=_ERRORS.get(column, "0.0"), sigma=float(sigma))

    def outliers(self, column: str = "gain_dn_per_e", sigma: float = 4.0) -> pandas.DataFrame:
        """Campaigns whose value is `sigma` standard deviations or more from the median of the cameras of their model."""
        import duckdb

        self._there()
        found: pandas.DataFrame = duckdb.connect().execute(self.outliers_sql(column, sigma)).df()
        return found

    def drifts(self, column: str = "gain_dn_per_e") -> pandas.DataFrame:
        """Of every camera with three days or more: change of a column per year, its standard error, and their ratio.

        A straight line by least squares, weighted by the standard errors; those are widened where the points scatter more.
        """
        import pandas

        _number(column)
        table = self.table().dropna(subset=[column])
        table = table[table["date"] != "unknown"]
        error = _ERRORS.get(column)
        rows = []
        for camera, of in table.groupby("camera"):
            year = of["date"].to_numpy("datetime64[D]").astype(float) / 365.25
            values = of[column].to_numpy(float)
            if len(np.unique(year)) < 3:
                continue
            errors = of[error].to_numpy(float) if error else np.ones(len(of))
            weight = 1 / np.square(errors)
            middle = np.average(year, weights=weight)
            square = np.sum(weight * np.square(year - middle))
            slope = np.sum(weight * (year - middle) * values) / square
            left = values - np.average(values, weights=weight) - slope * (year - middle)
            scatter = np.sum(weight * left**2) / (len(values) - 2)
            std_err = np.sqrt((max(scatter, 1.0) if error else scatter) / square)
            rows.append({"camera": camera, "per_year": slope, "std_err": std_err, "sigma": slope / std_err, "campaigns": len(of)})
        return pandas.DataFrame(rows, columns=["camera", "per_year", "std_err", "sigma", "campaigns"])

    def plot(self, column: str = "gain_dn_per_e", sigma: float = 4.0, axes: Axes | None = None) -> Axes:
        """Every campaign's value by camera, models side by side, each with its median, its band, and its outliers by name."""
        _number(column)
        if axes is None:
            from matplotlib.figure import Figure

            axes = Figure(figsize=(9, 4), layout="constrained").add_subplot()
        table = self.table().dropna(subset=[column])
        far = set(self.outliers(column, sigma)["campaign"])
        error = _ERRORS.get(column)
        names: list[str] = []
        for model, of in table.groupby("model"):
            own = sorted(of["camera"].unique())
            first, last = len(names), len(names) + len(own) - 1
            place = {camera: first + i for i, camera in enumerate(own)}
            names += own
            x = np.array([place[c] for c in of["camera"]])
            is_far = of["campaign"].isin(far).to_numpy()
            values = of[column].to_numpy(float)
            bars = of[error].to_numpy(float) if error else None
            drawn = axes.errorbar(x[~is_far], values[~is_far], None if bars is None else bars[~is_far], fmt=".", label=str(model))
            color = drawn[0].get_color()
            axes.errorbar(x[is_far], values[is_far], None if bars is None else bars[is_far], fmt="x", color="red")
            for camera in sorted({of["camera"].iloc[i] for i in np.flatnonzero(is_far)}):
                top = values[is_far & (of["camera"] == camera).to_numpy()].max()
                axes.annotate(camera, (place[camera], top), (6, 0), textcoords="offset points", color="red", fontsize="small")
            middle = np.median(values)
            scatter = np.median(np.abs(values - middle)) / 0.6745
            axes.fill_between([first - 0.5, last + 0.5], middle - sigma * scatter, middle + sigma * scatter, alpha=0.15, color=color, lw=0)
            axes.plot([first - 0.5, last + 0.5], [middle, middle], color=color, lw=0.5)
        axes.set(xlabel="camera", ylabel=f"{column}: {SCHEMA[column][1]}")
        # More names than these cannot be read.
        axes.set_xticks(range(len(names)) if len(names) <= 60 else [])
        if len(names) <= 60:
            axes.set_xticklabels(names, rotation=90, fontsize="x-small")
        axes.legend(title=f"model; band: {sigma:g} sigma of the siblings", fontsize="small", title_fontsize="small")
        return axes

    def _repr_html_(self) -> str:
        names = ["camera", "date", "effect", "error_before", "gain_dn_per_e", "read_noise_e", "k_std", "defects", "error"]
        html: str = self.table()[names].to_html(max_rows=40)
        return html
