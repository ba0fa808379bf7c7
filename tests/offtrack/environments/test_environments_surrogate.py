"""The surrogate of an off-tracking estimator: its errors are those it is said to have, and can be fitted."""

from pathlib import Path

import numpy as np
import pytest

from estimators.estimates import Health, OffTracking
from scenarios.assembly.surrogate import (
    Estimate,
    RunErrors,
    Surrogate,
    SurrogateOffTracking,
    SurrogateParameters,
    fitted,
    load_surrogate,
    run_errors,
    surrogate_toml,
)
from sensors.messages import BodyPose
from tests.environments import PERFECT
from vehicle.frames import FloatArray

N = 200


def changed(**values: float) -> SurrogateParameters:
    return SurrogateParameters(**PERFECT.model_dump() | values)


def truth(value: float) -> Estimate:
    return Estimate(
        np.full(N, value), np.zeros(N), np.zeros((N, 3)), np.ones((N, 3)), np.zeros(N), np.ones(N, dtype=bool)
    )


def begun(parameters: SurrogateParameters, latency: int = 100) -> Surrogate:
    """Surrogates of N trailers with a follow distance of 10 m, that know an off-tracking of 0."""
    surrogate = Surrogate(parameters, N, step=20, period=100, latency=latency)
    generators = [np.random.default_rng(k) for k in range(N)]
    surrogate.begin(np.arange(N), generators, np.ones(N), np.full(N, 10.0), truth(0.0))
    return surrogate


def errors(parameters: SurrogateParameters, frames: int) -> FloatArray:
    """Errors of every frame (frames, N); lost ones are NaN."""
    surrogate, found = begun(parameters, 0), []
    for k in range(5 * frames):
        known = surrogate.step(truth(1.0))
        if k % 5 == 0:
            found.append(np.where(known.usable, known.offset - 1.0, np.nan))
    return np.array(found)


@pytest.mark.parametrize("latency", [0, 40, 100])
def test_an_estimate_comes_after_its_latency_and_grows_old(latency: int) -> None:
    """Frames every 0.1 s: what is known changes once a frame, a latency late, and its age says how old it is."""
    surrogate = begun(PERFECT, latency)
    for k in range(40):
        known = surrogate.step(truth(0.01 * k))
        if k >= 10:
            frame = (k - latency // 20) // 5 * 5
            assert known.offset[0] == pytest.approx(0.01 * frame)
            assert known.age[0] == pytest.approx(0.02 * (k - frame))


def test_the_parts_of_the_error_are_as_large_as_said() -> None:
    """Standard deviations over two hundred runs of half a minute; 10 % is three sigma of such a sample's."""
    bias = errors(changed(bias=0.02), 300)
    assert np.ptp(bias, axis=0) == pytest.approx(np.zeros(N), abs=1e-12)
    assert bias[0].std() == pytest.approx(0.02, rel=0.15)  # one number a run: 200 of them
    assert errors(changed(noise=0.02), 300).std() == pytest.approx(0.02, rel=0.02)
    drift = errors(changed(drift=0.02), 300)
    assert drift.std() == pytest.approx(0.02, rel=0.1)
    correlation = np.mean(drift[20:] * drift[:-20]) / np.mean(drift**2)
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.06)  # 2 s apart


def test_the_error_grows_from_the_hitch_to_the_follow_point() -> None:
    """An odometry's error turns the path about the hitch, where the trailer is: direction and offset go together."""
    surrogate = begun(changed(bias=0.1), 0)
    known = surrogate.step(truth(0.0))
    assert known.direction == pytest.approx(-known.offset / 10.0)
    assert known.ahead[:, 1] == pytest.approx(0.5 * known.offset)


def test_health_is_lost_as_often_and_for_as_long_as_said() -> None:
    """A share of loss_duration over the time between two losses, and the last good estimate stays meanwhile."""
    lost = np.isnan(errors(changed(loss_rate=0.5, loss_duration=1.0), 500))
    assert lost.mean() == pytest.approx(1.0 / 3.0, rel=0.1)  # 1 s of every 1 s + 2 s
    surrogate = begun(changed(loss_rate=100.0, loss_duration=100.0), 0)
    for _ in range(20):
        known = surrogate.step(truth(1.0))
    assert np.all(known.offset[~known.usable] == 0.0)
    assert known.age[~known.usable].max() > 0.3


def test_a_fit_finds_the_parameters_that_errors_were_made_with() -> None:
    """Two hundred runs of a minute from the surrogate itself; the bias is known from 200 numbers, 3 sigma are 15 %."""
    made = changed(bias=0.01, drift=0.02, noise=0.01, loss_rate=0.1, loss_duration=0.5)
    found = fitted([RunErrors(column, 0.1) for column in errors(made, 599).T])
    for name, tolerance in (("bias", 0.25), ("drift", 0.1), ("drift_time", 0.25), ("noise", 0.1), ("loss_rate", 0.15)):
        assert getattr(found, name) == pytest.approx(getattr(made, name), rel=tolerance), name
    assert found.loss_duration == pytest.approx(0.5, rel=0.15)
    error = np.full(3000, np.nan)  # every thirtieth frame has an error: beyond the lags that drift is fitted to
    error[::30] = np.random.default_rng(1).normal(0.0, 0.02, 100)
    alone = fitted([RunErrors(error, 0.1)])
    assert alone.drift == 0.0
    assert alone.noise == pytest.approx(0.02, rel=0.2)


def test_a_fitted_file_is_read_again(tmp_path: Path) -> None:
    """To the digits it is written with; and the shipped one is such a file."""
    file = tmp_path / "own.toml"
    file.write_text(surrogate_toml(changed(bias=0.01234), 3, 100), encoding="utf-8")
    assert load_surrogate(file) == changed(bias=0.01234, velocity_noise=0.0)
    assert 0.0 < load_surrogate().drift < 0.05


def test_unsuitable_runs_and_impossible_parameters_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not a run directory"):
        run_errors(tmp_path)
    (tmp_path / "scenario.toml").write_text('off_tracking = "truth"\n')
    with pytest.raises(ValueError, match="off_tracking = truth must be one of viso_ot"):
        run_errors(tmp_path)
    for change, words in (({"noise": -1.0}, "noise"), ({"drift_time": 0.0}, "drift_time")):
        with pytest.raises(ValueError, match=words):
            changed(**change)
    with pytest.raises(ValueError, match="latency = 120"):  # one frame is on its way at a time
        Surrogate(PERFECT, 1, step=20, period=100, latency=120)


def test_the_errors_of_a_run_are_read_from_its_log(tmp_path: Path) -> None:
    """From the first estimate with health on, at the frames alone; lost ones in between are no numbers."""
    import pyarrow as pa
    import pyarrow.parquet

    health = np.full(400, np.nan)
    health[::4] = 0.0
    health[[0, 4, 200]] = 2.0  # two before there is a path, one within
    log = {
        "time": 0.025 * np.arange(400),
        "off_tracking_estimate": np.full(400, 0.51),
        "off_tracking_true": np.full(400, 0.5),
        "health": health,
    }
    pyarrow.parquet.write_table(pa.table(log), tmp_path / "signals.parquet")
    (tmp_path / "scenario.toml").write_text('off_tracking = "viso_ot"\n')
    run = run_errors(tmp_path)
    assert len(run.error) == 98
    assert np.isnan(run.error).sum() == 1
    assert np.nanmean(run.error) == pytest.approx(0.01)
    assert run.interval == pytest.approx(0.1)
    log["off_tracking_estimate"][:300] = np.nan  # healthy, yet without a number
    pyarrow.parquet.write_table(pa.table(log), tmp_path / "signals.parquet")
    with pytest.raises(ValueError, match="has 25 estimates, must have at least 50"):
        run_errors(tmp_path)


def run_of(parameters: SurrogateParameters, seed: int, n: int) -> list[OffTracking]:
    """Estimates of the scenarios' form, once 10 m lie behind the hitch: a metre straight ahead every 0.1 s."""
    source = SurrogateOffTracking(10.0, np.random.default_rng(seed), parameters)
    memory, found = source.init(), []
    for k in range(n + 11):
        X_WB = np.eye(4)
        X_WB[0, 3] = k
        memory, estimate = source.step(memory, BodyPose(tick=100 * k, X_WB=X_WB))
        if estimate is not None and k >= 11:
            found.append(estimate)
    return found


@pytest.mark.slow
def test_in_a_scenario_its_errors_are_the_same() -> None:
    """Bias, drift and noise as large as those of the environments' form, correlated as they are.

    Noise is known from fewer runs, and a bias, one number a run, from shorter ones.
    """
    for part, runs, frames in (("bias", 40, 22), ("drift", 40, 60), ("noise", 12, 40)):
        parameters = changed(**{part: 0.02})
        single = np.array([[one.value for one in run_of(parameters, seed, frames)] for seed in range(runs)]).T
        many = errors(parameters, frames)
        assert single.std() == pytest.approx(many.std(), rel=0.25)  # a bias: 40 numbers
        for lag in (1, 20):
            alone, together = (float(np.mean(each[lag:] * each[:-lag]) / np.mean(each**2)) for each in (single, many))
            assert alone == pytest.approx(together, abs=0.12)


def test_in_a_scenario_path_and_value_belong_together_and_health_is_lost_as_often() -> None:
    """The estimated path passes the follow point at the estimated value; its tangent turns with the path.

    Lost a fifth of the time; there is no value then, and an infinite deviation.
    """
    estimate = run_of(changed(bias=0.1, velocity_noise=0.01), 3, 5)[-1]
    assert abs(estimate.value) > 0.01
    assert np.interp(10.0, -estimate.path[:, 0], estimate.path[:, 1]) == pytest.approx(estimate.value)
    assert (estimate.path_tangent, estimate.std) == pytest.approx((-estimate.value / 10.0, 0.1))
    assert estimate.v_x != 10.0
    told = run_of(changed(loss_rate=0.5, loss_duration=0.5), 3, 600)
    lost = [one for one in told if one.health is Health.LOST]
    assert len(lost) / len(told) == pytest.approx(0.2, abs=0.06)
    assert all(one.value == 0.0 and np.isinf(one.std) for one in lost)
