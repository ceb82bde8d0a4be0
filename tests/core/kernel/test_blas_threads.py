"""OpenBLAS uses one thread while our own threads work, then is restored; bytes do not depend on it."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from data_tools.bench_strokes import clear_carrier_caches, make_keyed_stroke
from hnf_core.field import field
from hnf_core.field.field import FieldConfig, initial_parameters
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.threads import find_openblas_threads, single_blas_thread


@pytest.fixture
def threads():
    found = find_openblas_threads()
    if found is None:
        pytest.skip("this numpy did not come with OpenBLAS")
    count, choose = found
    before = count()
    choose(2)
    yield count
    choose(before)


def test_one_thread_inside_and_all_of_them_after(threads):
    with single_blas_thread():
        assert threads() == 1
        with single_blas_thread():
            assert threads() == 1
        assert threads() == 1
    assert threads() == 2
    with pytest.raises(ValueError, match="stop"), single_blas_thread():
        raise ValueError("stop")
    assert threads() == 2


def test_whoever_leaves_last_gives_them_back(threads):
    inside, leave = threading.Event(), threading.Event()

    def other():
        with single_blas_thread():
            inside.set()
            leave.wait(10.0)

    thread = threading.Thread(target=other)
    with single_blas_thread():
        thread.start()
        assert inside.wait(10.0)
    assert threads() == 1
    leave.set()
    thread.join()
    assert threads() == 2


def test_products_are_the_same(threads):
    random = np.random.default_rng(0)
    one, other = random.standard_normal((96, 300)), random.standard_normal((300, 500))
    many = one @ other
    with single_blas_thread():
        np.testing.assert_allclose(one @ other, many, rtol=1e-12, atol=1e-12)


def test_a_stroke_has_the_same_bytes_on_any_number_of_threads(threads):
    count, choose = find_openblas_threads()
    stroke, found = make_keyed_stroke(1.5), []
    for number in (1, 2):
        choose(number)
        assert count() == number
        clear_carrier_caches()
        found.append(synthesise(load_field(), stroke, seed=4).signal.samples)
    assert np.ptp(found[0]) > 0.1
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("portions", [2.0, 4.0, 7.5])
def test_pooled_evaluation_equals_serial_evaluation_bit_for_bit(monkeypatch, portions):
    """Two portions wait for each other, so that the pool cannot pass with one thread at work."""
    config, random = FieldConfig(hidden=256, layers=3), np.random.default_rng(5)
    parameters = {
        name: value + 0.1 * random.standard_normal(value.shape).astype(np.float32)
        for name, value in initial_parameters(config, 0).items()
    }
    width = parameters["layer0.weight"].shape[1]
    size, through = field.BATCH_ROWS, field._forward
    x = random.standard_normal((round(portions * size), width)).astype(np.float32)
    worked, meeting = [], threading.Barrier(2)

    def noted(*given):
        worked.append((threading.get_ident(), len(given[-1])))
        if len(worked) <= 2:
            meeting.wait(10.0)
        return through(*given)

    monkeypatch.setattr(field, "MIN_THREADED_MULTIPLICATIONS", 0)
    monkeypatch.setattr(field, "available_cpus", lambda: 2)
    with monkeypatch.context() as patch:
        patch.setattr(field, "_forward", noted)
        pooled = field.run_network(parameters, config.layers, x)
    assert len({thread for thread, _ in worked} - {threading.get_ident()}) == 2
    counts = [count for _, count in worked]
    assert sum(counts) == len(x)
    assert len(counts) % 2 == 0
    assert max(counts) <= min(size, min(counts) + 1)

    with single_blas_thread():
        rows = [through(parameters, config.layers, part) for part in np.array_split(x, len(counts))]
    monkeypatch.setattr(field, "MIN_THREADED_MULTIPLICATIONS", 1 << 60)
    plainly = field.run_network(parameters, config.layers, x)
    for head, (found, alone) in enumerate(zip(pooled, plainly, strict=True)):
        assert np.ptp(found) > 0.1
        assert found.tobytes() == alone.tobytes() == np.concatenate([row[head] for row in rows]).tobytes()
