"""Many campaigns on a Dask cluster."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

import radcam

pandas = pytest.importorskip("pandas")
distributed = pytest.importorskip("distributed")
fleet = pytest.importorskip("radcam.fleet")

#: RADCAM_TEST_CAMPAIGNS=200 runs the whole; its figures are in docs/fleet.md.
CAMPAIGNS = int(os.environ.get("RADCAM_TEST_CAMPAIGNS", "12"))
BROKEN = 3 if CAMPAIGNS >= 100 else 1


def is_hidden(i: int) -> bool:
    return i % 10 == 4


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> list[fleet.Campaign]:
    """One in ten with row noise, the last ones broken; cameras of one model, on different days."""
    folder = tmp_path_factory.mktemp("fleet")
    plain = radcam.Model.load("cmos12")
    plain.save(folder / "plain.toml")
    plain.add("row-noise", e=4.0).save(folder / "row.toml")
    made = []
    for i in range(CAMPAIGNS):
        path = folder / f"c{i:03}"
        radcam.simulate(folder / ("row.toml" if is_hidden(i) else "plain.toml"), path, "quick", region=(0, 0, 64, 64), seed=100 + i)
        made.append(fleet.Campaign(str(path), camera=f"S{i // 3:03}", date=f"2026-01-{1 + i % 3:02}"))
    for i in range(BROKEN):
        next((folder / f"c{CAMPAIGNS - 1 - i:03}" / "frames").glob("*.tiff")).write_bytes(b"no TIFF")
    return made


def test_a_cluster_says_what_single_runs_say(campaigns: list[fleet.Campaign], tmp_path: Path) -> None:
    begun = time.perf_counter()
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, env={"RAYON_NUM_THREADS": "1"}) as cluster:
        with distributed.Client(cluster) as client:
            # One of the two workers is killed in the middle.
            def kill() -> None:
                while len(list(tmp_path.glob("camera=*/date=*/*.parquet"))) < CAMPAIGNS // 3:
                    time.sleep(0.05)
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

            killer = threading.Thread(target=kill)
            killer.start()
            found = fleet.run(campaigns, tmp_path, cluster=client)
            killer.join()
    on_cluster = time.perf_counter() - begun
    table = found.table()
    assert len(table) == CAMPAIGNS and list(table.columns) == [*fleet.schema().names]
    failed = found.failed()
    assert sorted(failed["campaign"]) == sorted(c.path for c in campaigns[-BROKEN:])
    assert failed["error"].str.contains("DatasetError: frame").all()
    begun = time.perf_counter()
    rows = {r["campaign"]: r for r in table.to_dict("records")}
    for c in campaigns[:-BROKEN]:
        single = fleet.measure(c)
        for name in ("verdict", "effect", "gain_dn_per_e", "read_noise_e", "k_std", "error_after"):
            same = pandas.isna(rows[c.path][name]) if single[name] is None else rows[c.path][name] == single[name]
            assert same, (c, name, rows[c.path][name], single[name])
    loop = time.perf_counter() - begun
    print(f"{CAMPAIGNS} campaigns: {on_cluster:.1f} s on two workers, one killed; {loop:.1f} s in a loop; "
          f"{table['seconds'].sum() / len(table):.2f} s and {table['bytes'].mean() / 1e6:.2f} MB each")  # fmt: skip
    # Done campaigns are not measured again; failed ones are, once they are whole.
    before = {p: p.stat().st_mtime_ns for p in tmp_path.glob("camera=*/date=*/*.parquet")}
    broken = Path(campaigns[-1].path)
    bad = next(p for p in (broken / "frames").glob("*.tiff") if p.read_bytes() == b"no TIFF")
    bad.write_bytes((Path(campaigns[0].path) / "frames" / bad.name).read_bytes())
    again = fleet.run(campaigns, tmp_path, workers=1)
    after = {p: p.stat().st_mtime_ns for p in tmp_path.glob("camera=*/date=*/*.parquet")}
    assert len(again.failed()) == BROKEN - 1
    assert sum(before[p] != after[p] for p in before) == BROKEN
    drifts = again.drifts("offset_dn")
    # Cameras of which three days were measured; the last campaign is whole by now.
    whole = [c.camera for c in [*campaigns[:-BROKEN], campaigns[-1]]]
    assert len(drifts) == sum(whole.count(c) == 3 for c in set(whole)) and (drifts["sigma"].abs() < 6).all()


def test_outliers(tmp_path: Path) -> None:
    """A camera whose gain is off by 5 % among forty of one model is named by one query, and stands out in one picture."""
    import duckdb
    import numpy as np

    random = np.random.default_rng(7)
    for i in range(40):
        gain = 0.38 * (1 + 0.004 * random.standard_normal()) * (1.05 if i == 17 else 1)
        row = dict.fromkeys(fleet.SCHEMA) | {
            "campaign": f"/c/{i}", "camera": f"S{i:03}", "date": "2026-02-01", "model": "M" if i % 2 else "N", "gain_dn_per_e": gain,
            "gain_std_err": 0.0005, "verdict": "describes",
        }  # fmt: skip
        fleet._write(tmp_path, row, {})
    found = fleet.Fleet(tmp_path)
    far = found.outliers("gain_dn_per_e")
    assert list(far["camera"]) == ["S017"] and far["sigma"].iloc[0] > 4
    # The query stands by itself.
    assert duckdb.sql(found.outliers_sql()).fetchall()[0][0] == "S017"
    figure = found.plot().figure
    assert figure is not None
    figure.savefig(tmp_path / "fleet.png")
    with pytest.raises(ValueError, match="no column"):
        found.outliers("gain; drop table x")
    for wrong in (lambda: found.plot("verdict"), lambda: found.drifts("date")):
        with pytest.raises(ValueError, match="no column of numbers"):
            wrong()
    with pytest.raises(FileNotFoundError, match="no results"):
        fleet.Fleet(tmp_path / "empty").outliers()
    with pytest.raises(ValueError, match="YYYY-MM-DD"):
        fleet.Campaign("c", date="24.11.2026")
    # A name that is no path comes back as it was.
    odd = "Linie 3/€ 100%"
    fleet._write(tmp_path, row | {"camera": odd, "campaign": "/c/odd"}, {})
    assert odd in set(found.table()["camera"])
    assert odd in {r[0] for r in duckdb.sql(f"SELECT camera FROM ({found.outliers_sql(sigma=0.0)})").fetchall()}
