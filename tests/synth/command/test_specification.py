"""Study files: designs from TOML, and all mistakes at once."""

import numpy as np
import pytest
from literature import GAMMA_PECORILLA2024, cubesat_pecorilla2024

from synth.command.specification import read_study
from synth.delivery.modelfiles import read, save_system
from synth.errors import ModelError, SpecificationError
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace

SHAPING = """
[plant]
dt = 0
sample = 0.1
A = [[0, 1], [0, 0]]
B = [[0], [1]]
C = [[1, 0]]
D = [[0]]
[synthesis]
problem = "loopshaping"
feedback = "negative"
gamma_factor = 1.2
[weights]
W1 = { A = [[1]], B = [[0.02]], C = [[1]], D = [[1]] }
W2 = 2
[specifications]
ncf_margin = 0.1
"""


def study_of(text, folder):
    (folder / "study.toml").write_text(text)
    return read_study(folder / "study.toml")


def problems_of(text, folder):
    with pytest.raises(SpecificationError) as caught:
        study_of(text, folder)
    return list(caught.value.problems)


def test_loop_shaping_study(tmp_path):
    study = study_of(SHAPING, tmp_path)
    design = study.design()
    g = c2d(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]]), 0.1)
    W1 = StateSpace([[1.0]], [[0.02]], [[1.0]], [[1.0]], 0.1)
    same = ncfsyn(StateSpace(g.A, g.B, -g.C, g.D, 0.1), W1, 2 * np.eye(1), gamma_factor=1.2)
    assert design.controller.digest() == same.controller.digest()
    accepted = study.accept(design)
    assert accepted.passed
    assert study.missed(design, accepted) == []
    clipped = study_of(SHAPING + "umin = -1\numax = 1\n", tmp_path)
    assert any("A - L C has spectral radius" in text for text in clipped.missed(design, clipped.accept(design)))
    conditioned = study_of(SHAPING + "umin = -1\numax = 1\nantiwindup = true\n", tmp_path)
    assert conditioned.accept(design).passed
    wanting = study_of(
        SHAPING.replace("ncf_margin = 0.1", "ncf_margin = 0.9\nmax_norm = 1.0\numin = -1\numax = 1"), tmp_path
    )
    missed = wanting.missed(design, wanting.accept(design))
    assert any("above max_norm" in text for text in missed)
    assert any("ncf margin" in text for text in missed)


MIXED = """
[plant]  # 200 / ((10 s + 1) (0.05 s + 1)^2)
dt = 0
A = [[-0.1, 20, 0], [0, -20, 20], [0, 0, -20]]
B = [[0], [0], [20]]
C = [[1, 0, 0]]
D = 0
[synthesis]
problem = "mixedsensitivity"
shift = 0
[weights]
W1 = { A = [[-0.001]], B = [[1]], C = [[9.999333333333333]], D = [[0.6666666666666666]] }
W2 = 1
"""


def test_mixed_sensitivity_of_the_textbook(tmp_path):
    """Skogestad and Postlethwaite (2005), example 2.17, first design: gamma 1.37."""
    study = study_of(
        MIXED.replace("dt = 0\n", 'dt = 0\nu = ["valve"]\ny = ["level"]\nunits = { level = "m" }\n'), tmp_path
    )
    design = study.design()
    assert (design.plant.u, design.plant.y) == (("valve",), ("error level",))
    assert design.plant.units == {"error level": "m"}
    assert design.gamma == pytest.approx(1.37, abs=5e-3)
    assert study.accept(design) is None
    assert study.missed(design, None) == []
    held = study_of(MIXED + "[specifications]\nphase_margin_deg = 30\ndt = 0.001\n", tmp_path)
    accepted = held.accept(design)
    assert accepted is not None
    assert accepted.passed


def test_a_continuous_design_with_margins_needs_a_period(tmp_path):
    (problem,) = problems_of(MIXED + "[specifications]\nphase_margin_deg = 30\n", tmp_path)
    assert problem.startswith("specifications.dt: missing; the gate measures a sampled controller")


def test_names_that_loop_shaping_would_drop_are_refused(tmp_path):
    (problem,) = problems_of(SHAPING.replace("[plant]\n", '[plant]\nu = ["force"]\n', 1), tmp_path)
    assert problem.startswith("plant.u: loop shaping has no use for names")


def test_weights_of_mixed_sensitivity_are_checked(tmp_path):
    (problem,) = problems_of(MIXED.split("W1 =")[0], tmp_path)
    assert problem == "weights: W1, W2 and W3 are all None; pass at least one weight, or z would be empty"
    (problem,) = problems_of(MIXED.replace("[[-0.001]]", "[[0.001]]"), tmp_path)
    assert problem.startswith("weights: W1 has a pole at 0.001, which is not stable")


def test_generalised_plant_from_a_file_beside_the_study(tmp_path):
    plant = cubesat_pecorilla2024()
    save_system(tmp_path / "plant.json", plant)
    study = study_of('plant.file = "plant.json"\nsynthesis = { problem = "generalized", method = "riccati" }', tmp_path)
    assert study.plant.system.digest() == plant.system.digest()
    design = study.design()
    assert design.info.method == "riccati"
    assert design.info.optimum == pytest.approx(GAMMA_PECORILLA2024, rel=1e-6)
    assert design.gamma == pytest.approx(GAMMA_PECORILLA2024, rel=1e-5)
    assert design.gamma == pytest.approx(hinfsyn(plant, method="riccati").gamma)


def test_generalised_plant_in_matrices(tmp_path):
    text = """
    [plant]
    dt = 0
    A = -1
    B1 = [[1, 0]]
    B2 = 1
    C1 = [[1], [0]]
    D11 = [[0, 0], [0, 0]]
    D12 = [[0], [1]]
    C2 = 1
    D21 = [[0, 1]]
    D22 = [[0]]
    y = ["position"]
    [synthesis]
    problem = "generalized"
    gamma = 10
    [specifications]
    dt = 0.01
    """
    study = study_of(text.replace("    A = -1", "    A = [[-1]]"), tmp_path)
    assert study.plant.y == ("position",)
    design = study.design()
    assert design.info.level == 10
    assert design.gamma <= 10
    assert study.accept(design).dt == 0.01
    late = text.replace("    A = -1", "    A = [[-1]]\n    sample = 0.5\n    delay = 0.2").replace("dt = 0.01", "")
    study = study_of(late, tmp_path)
    assert (study.plant.delay, study.plant.continuous.y) == (0.2, ("y0",))
    design = study.design()
    assert design.intersample.lower < design.certify().intersample.upper < design.intersample.upper * (1 + 1e-5)
    assert "delay is [1, 2]" in problems_of(late.replace("delay = 0.2", "delay = [1, 2]"), tmp_path)[0]
    twice = text.replace("    A = -1", "    A = [[-1]]").replace('["position"]', '["position", "position"]')
    assert problems_of(twice, tmp_path)[0].startswith("plant: channel y has names ('position', 'position')")


def test_all_mistakes_are_told_at_once(tmp_path):
    text = SHAPING.replace("[0, 0]]", '[0, "x"]]', 1).replace("sample = 0.1", "sampel = 0.1")
    text = text.replace("gamma_factor = 1.2", 'gamma_factor = 0.9\nmethod = "lmy"').replace("W2 = 2", "W3 = 2")
    text = text.replace("ncf_margin = 0.1", "ncf_margin = true\nphase_margin = 30") + "[outlook]\n"
    found = problems_of(text, tmp_path)
    assert sorted(found) == sorted(
        [
            "plant.sampel: unknown; did you mean 'sample'?",
            "plant.A[1][1]: expected a number, found text ('x')",
            "synthesis.method: 'lmy' is not one of riccati, lmi; did you mean 'lmi'?",
            "synthesis.gamma_factor: 0.9 is not above 1",
            "specifications.ncf_margin: expected a number, found true or false (True)",
            "specifications.phase_margin: unknown; did you mean 'phase_margin_deg'?",
            "weights.W3: unknown; did you mean 'W2'?",
            "outlook: unknown",
        ]
    )


TRACKING = """
[plant]
dt = 0.5
A = [[1, 0.5], [0, 1]]
B = [[0], [1]]
C = 1
D = [[0], [0]]
[synthesis]
problem = "tracking"
[weights]
Wproc = 1
Wdist = 1
Werr = { diag = [1, 1] }
Wact = 1
Wr = 1
"""


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("Wproc = 1", "Wproc = [[1, 2]]", "weights.Wproc: expected shape 1 x 1, found 1 x 2"),
        ("Wproc = 1\n", "", "weights.Wproc: missing; expected shape 1 x 1"),
        ("diag = [1, 1]", "diag = [1, 1, 1]", "weights.Werr: expected shape 2 x 2, found 3 x 3"),
        ("diag = [1, 1]", 'diag = [1, "a"]', "weights.Werr.diag[1]: expected a number, found text ('a')"),
        ("diag = [1, 1]", "dig = [1, 1]", "weights.Werr.dig: unknown; did you mean 'diag'?"),
        ("[1, 0.5]", "[1, nan]", "plant.A[0][1]: nan is not finite"),
        ("[1, 0.5]", "[1]", "plant.A[1]: 2 entries where row 0 has 1"),
        ("dt = 0.5", "dt = -1", "plant.dt: -1 is not at least 0"),
        ("dt = 0.5\n", "", "plant.dt: missing; 0 for continuous time, or the sampling time in s"),
        ("dt = 0.5", "dt = 0.5\nsample = 1", "plant: the system G is already discrete (dt = 0.5 s)"),
        ("dt = 0.5", 'dt = 0.5\nu = ["a", "b"]', "plant.u: expected 1 different names, found 2"),
        ("tracking", "loopshaping", "weights.Wproc: unknown"),
        ("tracking", "generalized", "plant: the problem 'generalized' needs a plant with A, B1, B2, ..., D22"),
        ('problem = "tracking"', "", "synthesis.problem: missing; one of tracking, generalized, loopshaping"),
        ("dt = 0.5", 'file = "no.json"', "plant.file: no.json: there is no such file"),
        ("Wr = 1", "Wr = 1\n[specifications]\nantiwindup = true", "specifications.antiwindup: there are no limits"),
        ("Wr = 1", "Wr = 1\n[specifications]\numin = [1, 2]", "specifications.umin: expected 1 numbers, found 2"),
    ],
)
def test_each_mistake_names_its_path(tmp_path, old, new, problem):
    assert study_of(TRACKING, tmp_path).problem == "tracking"
    assert any(text.startswith(problem) for text in problems_of(TRACKING.replace(old, new), tmp_path))


def test_mistakes_of_kind_and_of_shape_are_told_together(tmp_path):
    """What is wrong in itself hides nothing of what does not fit together."""
    text = TRACKING.replace("B = [[0], [1]]", "B = [[0], [1], [2]]").replace("Wact = 1", 'Wact = "heavy"')
    text = text.replace("diag = [1, 1]", "diag = [1, 1, 1]") + "[specifications]\numin = [nan]\nmax_norm = 0\n"
    assert {problem.split(":")[0] for problem in problems_of(text, tmp_path)} == {
        "plant.B", "weights.Wact", "specifications.umin", "specifications.max_norm",
    }  # fmt: skip


def test_files_that_are_none(tmp_path):
    with pytest.raises(SpecificationError, match="cannot be read"):
        read_study(tmp_path / "no.toml")
    with pytest.raises(SpecificationError, match="cannot be read"):
        read_study(tmp_path)
    assert "it is no TOML" in problems_of("[plant", tmp_path)[0]
    assert problems_of("", tmp_path)[0] == "plant: missing"


POLYNOMIALS = """
[plant]
num = [200]
den = [0.025, 1.0025, 10.1, 1]
dt = 0
[synthesis]
problem = "mixedsensitivity"
[weights]
W1 = { zeros = [-15.0], poles = [-1e-3], gain = 0.6666666666666666 }
W2 = { num = 1.0, den = 1 }
"""


def test_transfer_functions_are_the_matrices_that_they_stand_for(tmp_path):
    found, expected = study_of(POLYNOMIALS, tmp_path), study_of(MIXED.replace("shift = 0\n", ""), tmp_path)
    assert found.design().verified_norm == pytest.approx(expected.design().verified_norm, rel=1e-4)


def test_mistakes_in_polynomials_have_their_paths(tmp_path):
    for wrong, path in (
        (POLYNOMIALS.replace("den = [0.025, 1.0025, 10.1, 1]\n", ""), "plant: plant has no den"),
        (POLYNOMIALS.replace("[200]", "[1, 0, 0, 0, 0]"), "plant: plant is improper"),
        (POLYNOMIALS.replace("[200]", '["a"]'), "plant: a polynomial of plant"),
        (POLYNOMIALS.replace("gain = 0.6666666666666666", "gain = true"), "weights.W1: the gain of W1 is True"),
        (POLYNOMIALS.replace("zeros = [-15.0]", 'zeros = ["-1+2j"]'), "weights.W1: W1 has complex zeros without"),
        (POLYNOMIALS.replace("num = 1.0, den", "nom = 1.0, den"), "weights.W2.nom: unknown"),
    ):
        problems = problems_of(wrong, tmp_path)
        assert any(text.startswith(path) for text in problems), problems


def test_delays_of_whole_samples_and_of_parts(tmp_path):
    late = study_of(SHAPING.replace("sample = 0.1", "sample = 0.1\ndelay = 0.2"), tmp_path)
    g = c2d(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]]), 0.1)
    for omega in (0.3, 5.0):
        expected = -g.frequency_response(omega) * np.exp(-0.2j * omega)
        np.testing.assert_allclose(late.plant.frequency_response(omega), expected, rtol=1e-9)
    part = study_of(SHAPING.replace("sample = 0.1", "sample = 0.1\ndelay = 0.25"), tmp_path)
    G = StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])
    np.testing.assert_allclose(
        part.plant.frequency_response(0.3), -c2d(G, 0.1, delay=0.25).frequency_response(0.3), rtol=1e-12
    )
    held = "sample = 0.1\nhold = 'tustin'\ndelay = 0.25"
    (problem,) = problems_of(SHAPING.replace("sample = 0.1", held), tmp_path)
    assert "method 'tustin' has whole ones only" in problem
    sampled = SHAPING.replace("dt = 0", "dt = 0.1").replace("sample = 0.1", "delay = 0.25")
    (problem,) = problems_of(sampled, tmp_path)
    assert problem.startswith("plant: delay is 0.25 s, [2.5] samples of 0.1 s")
    assert any("sample the plant first" in text for text in problems_of(
        SHAPING.replace("sample = 0.1", "delay = 0.2"), tmp_path
    ))  # fmt: skip


def test_system_files_hold_transfer_functions(tmp_path):
    path = tmp_path / "plant.json"
    text = '{"format": "convex-synth system", "format_version": 1, "dt": 0.5, "num": [1], "den": [1, -0.5], "delay": 1}'
    path.write_text(text)
    found = read(path).system
    z = np.exp(0.4j)
    assert found.frequency_response(0.8)[0, 0] == pytest.approx(1 / (z - 0.5) / z**2, rel=1e-12)
    path.write_text(text.replace('"den": [1, -0.5]', '"den": [0]'))
    with pytest.raises(ModelError, match="denominator 0"):
        read(path)
    path.write_text(text.replace('"den": [1, -0.5], ', ""))
    with pytest.raises(ModelError, match="has no den"):
        read(path)
