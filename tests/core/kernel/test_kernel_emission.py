"""Inputs and amplitudes of F_Θ by the compiled kernel equal those of numpy for every supported form of field."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core import threads as both_cores
from hnf_core.field.carriers import Carriers
from hnf_core.field.field import (
    Field,
    FieldConfig,
    evaluate,
    get_emitter,
    initial_parameters,
    kernel_supports,
    run_network,
)
from hnf_core.field.linear_contact import Condition
from hnf_core.field.live.emission import LiveEmission
from hnf_core.field.weights import load_field
from hnf_core.kernel import compiled_field
from hnf_core.kernel.compiled_field import (
    CONTACT_COLUMNS,
    MOTION_COLUMNS,
    ContactPrior,
    EmissionTables,
    Layers,
    StateEvaluator,
)
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import get_material, load_library
from hnf_core.material.probe import PROBE_NAMES
from hnf_lab.bench.synth import TableGrid, evaluate_table, interpolate_table, tabulate_field

needs_kernel = pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")
SHARED, LIBRARY = load_field(), load_library()
FORMS = {
    "shipped": SHARED.config,
    "directed": FieldConfig(hidden=24, layers=2, line_gains=True),
    "undirected": FieldConfig(hidden=24, layers=1, directed=False),
    "a value for each band": FieldConfig(hidden=24, layers=2, arc_knots=0, stroke_frame=True, line_gains=True),
    "one knot": FieldConfig(hidden=24, layers=2, arc_knots=1),
    "few carriers": FieldConfig(16, 2, carriers=Carriers(time_edges_hz=(5.0, 40.0, 300.0), arc_octaves=3), arc_knots=7),
}


def field_of(name: str) -> Field:
    if name == "shipped":
        return SHARED
    rng, parameters = np.random.default_rng(3), initial_parameters(FORMS[name], 5)
    heads_too = {
        key: value + 0.1 * rng.standard_normal(value.shape).astype(np.float32) if key[:5] in ("alpha", "sigma", "skip")
        else value for key, value in parameters.items()
    }  # fmt: skip
    return Field(FORMS[name], heads_too)


def states(seed: int, count: int = 40, probe: str = "pen") -> Condition:
    """Of two materials, some resting, some in the air, some faster and heavier than any hand."""
    rng = np.random.default_rng(seed)
    chosen = [LIBRARY[int(index)] for index in rng.choice(len(LIBRARY), 2)]
    material, angle = rng.integers(0, 2, count).astype(np.int32), rng.uniform(-np.pi, np.pi, count)
    tokens = np.array([chosen[index].token for index in material], dtype=np.float64)
    known = chosen[1].mechanics if rng.random() < 0.5 else Mechanics(None, None, None)
    return Condition(
        tokens, (chosen[0].mechanics, known), material, np.stack([np.cos(angle), np.sin(angle)], axis=1),
        np.where(rng.random(count) < 0.1, 0.0, np.exp(rng.uniform(-9.0, 1.0, count))),
        np.where(rng.random(count) < 0.1, 0.0, np.exp(rng.uniform(-6.0, 3.0, count))), rng.random(count) < 0.9, probe,
    )  # fmt: skip


@needs_kernel
@pytest.mark.parametrize("name", FORMS)
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(sorted(PROBE_NAMES)))
def test_what_is_emitted_is_what_numpy_says(name, seed, probe):
    field, condition = field_of(name), states(seed, probe=probe)
    assert kernel_supports(field.config)
    found = evaluate(field, condition)
    with without_kernel():
        wanted = evaluate(field, condition)
    assert found.alpha.shape == wanted.alpha.shape
    assert wanted.alpha.max() > 0.0
    np.testing.assert_allclose(found.alpha, wanted.alpha, rtol=2e-5, atol=1e-7 * wanted.alpha.max())
    np.testing.assert_allclose(found.sigma_dt, wanted.sigma_dt, rtol=2e-5, atol=1e-6)
    still = ~condition.contact | (condition.speed == 0.0) | (condition.force == 0.0)
    assert not found.alpha[still].any()


def test_unsupported_field_forms_fall_back_to_numpy():
    published = FieldConfig.published(16)
    bare = FieldConfig(16, 1, physics=False)
    encoded = FieldConfig(16, 1, action_octaves=2)
    for config in (published, bare, encoded, replace(bare, carriers=Carriers(arc_octaves=0))):
        assert not kernel_supports(config)
        found = evaluate(Field(config, initial_parameters(config, 1)), states(4))
        assert found.alpha.shape == (40, config.alpha_heads, config.carriers.count)


@needs_kernel
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 70), st.integers(1, 4), st.sampled_from(sorted(PROBE_NAMES)))
def test_one_state_after_another_is_all_of_them_at_once(seed, hidden, layers, probe):
    """Whatever the widths, and whatever the state before has left."""
    config = replace(SHARED.config, hidden=hidden, layers=layers)
    rng, parameters = np.random.default_rng(seed), initial_parameters(config, seed)
    for name in ("alpha.weight", "alpha.bias", "sigma.weight"):
        parameters[name] = (0.3 * rng.standard_normal(parameters[name].shape)).astype(np.float32)
    field, told = Field(config, parameters), states(seed, 6, probe)
    told = replace(told, tokens=told.tokens[:1].repeat(6, axis=0), material=np.zeros(6, np.int32))
    one = LiveEmission(field, told.tokens[0], told.mechanics[0], probe)
    wanted = evaluate(field, told)
    for row in range(6):
        asked = told.direction[row], float(told.speed[row]), float(told.force[row]), bool(told.contact[row])
        alpha, sigma = one.evaluate(*asked)
        np.testing.assert_allclose(alpha, wanted.alpha[row, 0], rtol=2e-4, atol=1e-6 * wanted.alpha.max())
        np.testing.assert_allclose(sigma, wanted.sigma_dt[row], rtol=2e-4, atol=1e-6)


class Refuses:
    """A kernel that must not be called."""

    def __getattr__(self, name: str):
        return lambda *given: pytest.fail(f"{name} was called")


def test_what_the_kernel_would_misread_never_reaches_it():
    none, config = Refuses(), SHARED.config
    skip = SHARED.parameters["skip"].tobytes()
    emitter = get_emitter(config, skip, "pen", 6.0)
    tokens, fixed = np.ones((2, emitter.token_size)), np.ones((2, emitter.fixed))
    motion, touch = np.ones((2, len(MOTION_COLUMNS))), np.ones((2, len(CONTACT_COLUMNS)))
    for wrong in (
        (tokens[:1], fixed, motion, touch), (tokens[:, 1:], fixed, motion, touch), (tokens, fixed[1:], motion, touch),
        (tokens, fixed, motion[:, 1:], touch), (tokens, fixed, motion, touch[1:]),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="tokens"):
            compiled_field.compute_inputs(none, emitter, *wrong)
    with pytest.raises(TypeError, match="float64"):
        compiled_field.compute_inputs(none, emitter, tokens.astype(np.float32), fixed, motion, touch)
    expected, head = ContactPrior.empty(2, emitter), np.ones((2, emitter.outputs), np.float32)
    for wrong in ((head[:, 1:], motion, expected), (head, motion[:1], expected)):
        with pytest.raises(ValueError, match="answers"):
            compiled_field.decode_head(none, emitter, *wrong)
    for wrong in (
        (tokens, motion, touch[:1], head),
        (tokens, motion, touch, head[:, 1:]),
        (tokens[:1], motion, touch, head),
    ):
        with pytest.raises(ValueError, match=r"tokens|answers"):
            compiled_field.decode_known_head(none, emitter, *wrong)
    with pytest.raises(ValueError, match="expected"):
        compiled_field.decode_head(none, emitter, head, motion, ContactPrior.empty(3, emitter))
    counts = {
        name: getattr(emitter.struct, name)
        for name in compiled_field._EMISSION_COUNTS + compiled_field._EMISSION_NUMBERS
    }
    arrays = dict(zip(compiled_field._EMISSION_ARRAYS, emitter._arrays, strict=True))
    derived = {"token_size", "time_bands", "carriers", "harmonics"}
    told = {**arrays, **{name: value for name, value in counts.items() if name not in derived}}
    EmissionTables(emitter.tables, **told)
    for gap in ({"fixed_at": told["fixed_at"] + 1}, {"fixed": told["fixed"] - 1}, {"fixed": told["fixed"] + 1}):
        with pytest.raises(ValueError, match="inputs"):
            EmissionTables(emitter.tables, **told | gap)
    for change in ({"arc_knots": 99}, {"line_gains": False, "hidden": 8}):
        fewer = replace(config, **change)
        assert get_emitter(fewer, skip, "pen", 6.0).outputs == fewer.alpha_outputs
    with pytest.raises(ValueError, match="carriers"):
        get_emitter(config, skip[4:], "pen", 6.0)
    shapes = (3, emitter.inputs), (emitter.outputs, 3), (5, 3)
    weights, biases = ([np.ones(each, np.float32) for each in some] for some in (shapes, [s[0] for s in shapes]))
    layers = Layers(weights, biases)
    for wrong in (
        (weights[::-1], biases), (weights, biases[::-1]), (weights[1:], biases), (weights[:1], biases[:1]),
        ([np.ones((3, 2), np.float32), weights[1][:, :2], weights[2]], biases),
        (weights, [each[1:] for each in biases]), ([weights[0], weights[1], weights[2][:, 1:]], biases),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="layers"):
            Layers(*wrong)
    for wrong in (
        ([each.astype(float) for each in weights], biases),
        (weights, [each.astype(float) for each in biases]),
    ):
        with pytest.raises(TypeError, match="float32"):
            Layers(*wrong)
    x = np.ones((4, emitter.inputs), np.float32)
    for wrong in (x[:, 1:], x[0]):
        with pytest.raises(ValueError, match="inputs"):
            layers.evaluate(none, wrong)
    for wrong in (x.astype(float), np.asfortranarray(x)):
        with pytest.raises(TypeError, match="float32"):
            layers.evaluate(none, wrong)
    state = emitter, layers, tokens[:1], fixed[:1]
    StateEvaluator(*state)
    narrower = Layers([weights[0][:, 1:], *weights[1:]], biases)
    for at, wrong in ((1, narrower), (2, tokens[:1, 1:]), (3, fixed)):
        with pytest.raises(ValueError, match=r"layers|tokens"):
            StateEvaluator(*state[:at], wrong, *state[at + 1 :])
    with pytest.raises(struct.error):
        StateEvaluator(*state).evaluate(none, np.ones(len(MOTION_COLUMNS) - 1), np.ones(len(CONTACT_COLUMNS)))


@pytest.mark.parametrize("name", FORMS)
def test_precomputed_network_outputs_give_the_same_emission(monkeypatch, name):
    """No inputs are made for them; on one core and on two, bit for bit."""
    field, condition, said = field_of(name), states(6, 300), []

    def noted(x):
        said.append(run_network(field.parameters, field.config.layers, x))
        return said[-1]

    wanted = evaluate(field, condition, noted)
    for cores in (1, 2):
        monkeypatch.setattr(both_cores, "available_cpus", lambda cores=cores: cores)
        for found in (evaluate(field, condition, said[0]), evaluate(field, condition, lambda _: said[0])):
            np.testing.assert_array_equal(found.alpha, wanted.alpha)
            np.testing.assert_array_equal(found.sigma_dt, wanted.sigma_dt)
    assert wanted.alpha.max() > 0.0


@pytest.mark.parametrize("name", FORMS)
def test_a_network_that_is_broken_is_never_a_number(name):
    """NaN in what the head answers is NaN in what is emitted, by either way: a limit does not make it the loudest."""
    field, condition = field_of(name), states(6, 30)
    said = run_network(
        field.parameters, field.config.layers, np.ones((30, field.parameters["layer0.weight"].shape[1]), np.float32)
    )
    unbroken = evaluate(field, condition, said).alpha
    for output in range(0, field.config.alpha_outputs, 7):
        head = said[0].copy()
        head[:, output] = np.nan
        found = evaluate(field, condition, (head, said[1])).alpha
        with without_kernel():
            wanted = evaluate(field, condition, (head, said[1])).alpha
        # Numpy's product of matrices carries NaN to every band of arc length; the kernel to those that hear the output.
        assert np.isnan(wanted[np.isnan(found)]).all()
        np.testing.assert_array_equal(found[~np.isnan(found)], unbroken[~np.isnan(found)])
        assert output >= field.config.carriers.time_count or np.isnan(found[:, 0, output]).any()


def test_a_table_answers_what_the_network_does():
    """At its own points exactly, between them nearer where it is finer, and once for a material that has no grain."""
    leather = get_material("leather")
    token = leather.token.astype(np.float32)
    table = tabulate_field(SHARED, token, leather.mechanics, "pen", TableGrid(4, 2, 1))
    directions, speeds, forces, _ = table.values.shape
    rng = np.random.default_rng(2)
    d, v, f = (rng.integers(0, count - 1, 30) for count in (directions, speeds, forces))
    angle = d * table.angle_step + np.pi * rng.integers(0, 2, 30)
    at = Condition(
        np.tile(token.astype(np.float64), (30, 1)), (leather.mechanics,), np.zeros(30, np.int32),
        np.stack([np.cos(angle), np.sin(angle)], axis=1), np.exp(table.speed[0] + v * table.speed[1]),
        np.exp(table.force[0] + f * table.force[1]), np.ones(30, bool), "pen",
    )  # fmt: skip
    np.testing.assert_allclose(interpolate_table(table, at), table.values[d, v, f], atol=1e-5)
    between = replace(at, speed=at.speed * 1.1, force=at.force * 1.2)
    wanted, missed = evaluate(SHARED, between).alpha, []
    for grid in (TableGrid(4, 2, 1), TableGrid(4, 16, 4)):
        finer = tabulate_field(SHARED, token, leather.mechanics, "pen", grid)
        missed.append(np.square(evaluate_table(finer, SHARED, between).alpha - wanted).sum() / np.square(wanted).sum())
    assert missed[1] < 0.25 * missed[0]
    assert missed[1] < 1e-3
