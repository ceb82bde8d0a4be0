"""OpenBLAS's threads are held to one while views run in threads of our own, and given back."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from hnf_core.bench.synth import forget_carriers, ten_seconds
from hnf_core.blas import one_blas_thread, openblas_threads
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field


@pytest.fixture
def threads():
    found = openblas_threads()
    if found is None:
        pytest.skip("this numpy did not come with OpenBLAS")
    count, choose = found
    before = count()
    choose(2)
    yield count
    choose(before)


def test_one_thread_inside_and_all_of_them_after(threads):
    with one_blas_thread():
        assert threads() == 1
        with one_blas_thread():
            assert threads() == 1
        assert threads() == 1
    assert threads() == 2
    with pytest.raises(ValueError, match="stop"), one_blas_thread():
        raise ValueError("stop")
    assert threads() == 2


def test_whoever_leaves_last_gives_them_back(threads):
    inside, leave = threading.Event(), threading.Event()

    def other():
        with one_blas_thread():
            inside.set()
            leave.wait(10.0)

    thread = threading.Thread(target=other)
    with one_blas_thread():
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
    with one_blas_thread():
        np.testing.assert_allclose(one @ other, many, rtol=1e-12, atol=1e-12)


def test_a_stroke_has_the_same_bytes_on_any_number_of_threads(threads):
    count, choose = openblas_threads()
    stroke, found = ten_seconds(1.5), []
    for number in (1, 2):
        choose(number)
        assert count() == number
        forget_carriers()
        found.append(synthesise(load_field(), stroke, seed=4).signal.samples)
    assert np.ptp(found[0]) > 0.1
    np.testing.assert_array_equal(*found)
