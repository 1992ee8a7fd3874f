"""The CubeSat study without its flights: opponents, margins, work, rules on made-up results, lines of the paper."""

import re
from types import SimpleNamespace

import cubesat3u as study
import cubesat3u_claims as claims
import cubesat3u_controllers as controllers
import cubesat3u_findings as findings
import cubesat3u_robustness as robustness
import numpy as np
import pytest
from cubesat3u_flights import Measured, of_wide_inertia, starts

import synth
from plants.missions import cubesat3u
from plants.outcome.claims import Reading, Rule, judged


@pytest.fixture(scope="module")
def designed():
    return controllers.design_controllers()


@pytest.mark.parametrize("name", ["Hinf", "PD", "MPC velocity", "MPC position"])
def test_linear_law_is_what_steps(designed, name):
    controller, law = designed[1][name], controllers.linear_law(designed[1][name])
    rng, x, state = np.random.default_rng(0), np.zeros(law.n), controller.init()
    for y in 1e-7 * np.vstack([np.zeros(6), rng.normal(size=(40, 6)) * [1, 1, 1, 0.1, 0.1, 0.1]]):
        state, u = controller.step(state, y, np.zeros(6))
        np.testing.assert_allclose(law.C @ x + law.D @ y, u, rtol=0, atol=1e-13)
        x = law.A @ x + law.B @ y


@pytest.mark.parametrize("damping", [0.5, 0.8, 1.2])
def test_pd_crosses_over_where_hinf_does(designed, damping):
    design = designed[0]
    pd = controllers.same_bandwidth(design.margins, damping)
    found = synth.margins(controllers.model(), controllers.linear_law(pd), sign=1)
    for own, other in zip(found.input, design.margins.input, strict=True):
        assert own.phase_frequency == pytest.approx(other.phase_frequency, rel=5e-3)


def test_margins_of_the_study(designed):
    """Of the issue: an MPC bears no delay, and its velocity form hardly any gain; the phase of the other is Hinf's."""
    found = {name: robustness.margins_of(controller) for name, controller in designed[1].items()}
    assert found["Hinf"]["delay, periods"] == pytest.approx(5.54, abs=0.01)
    assert max(found[f"MPC {form}"]["delay, periods"] for form in controllers.FORMS) < 1
    assert found["MPC velocity"]["gain, dB"] < 3 < found["MPC position"]["gain, dB"] < 6 < found["Hinf"]["gain, dB"]
    assert found["PD"]["disk, all axes at once"] > found["Hinf"]["disk, all axes at once"]
    ratios = robustness.margin_ratios(designed[1])
    assert min(ratios, key=lambda key: ratios[key].value) == ("phase, deg", "position form")
    verdicts = verdicts_of(SimpleNamespace(controllers=designed[1], window=300.0))
    assert verdicts["Hinf gives greater control robustness"] == "depends on the margin and the form of the MPC"
    assert verdicts["Hinf costs less computation than MPC"] == "holds"


def test_work_is_what_the_c_code_does(designed, tmp_path):
    """Every coefficient that the C code holds is multiplied and added once in a step."""
    for name, work in (("Hinf", 216), ("PD", 36)):
        law = designed[1][name] if name == "Hinf" else controllers.same_bandwidth(designed[0].margins)
        _, source = synth.export(law, "c", tmp_path, name=name.lower(), self_test=False)
        tables = re.findall(r"static const double \w+(?:\[\w+\])+ = \{(.*?)\};", source.read_text(), re.DOTALL)
        assert tables
        assert 2 * sum(len(re.findall(r"[-\d.e+]+", table)) for table in tables) == work
        assert controllers.flops(designed[1][name]) == work


def test_wide_inertia_keeps_table_3_and_fills_its_box():
    drawn = starts(200, 0)
    wide = of_wide_inertia(drawn)
    np.testing.assert_allclose(wide.inertia[0], cubesat3u.INERTIA, rtol=1e-15)
    off = wide.inertia / cubesat3u.INERTIA - 1
    assert 0.45 < np.abs(off).max() <= 0.5
    np.testing.assert_array_equal(wide.angles, drawn.angles)


def test_dependence_names_the_factors_that_matter():
    rule = Rule("x", "<", 1)
    low, high, both = Reading("", 0.5), Reading("", 2.0), Reading("", 1.0, 0.5, 2.0)
    four = {("a", "c"): low, ("a", "d"): low, ("b", "c"): high, ("b", "d"): high}
    assert claims.dependence(rule, four, ("first", "second")) == "first"
    assert claims.dependence(rule, four | {("b", "d"): low}, ("first", "second")) == "first and second"
    assert claims.dependence(rule, dict.fromkeys(four, low), ("first", "second")) == "the case"
    assert claims.dependence(rule, {("a", "c"): low, ("a", "d"): both}, ("first", "second")) == "the case"


@pytest.mark.parametrize("k", [0, 10, 25, 30])
def test_share_has_its_exact_interval(k):
    reading = claims.share(np.arange(30) < k)
    assert reading.low <= reading.value == k / 30 <= reading.high
    assert claims.MEETS.met(reading) in ((True,) if k == 30 else (None,) if k == 25 else (False,))


def verdicts_of(found):
    """Of the claims that what is there suffices for, by their text."""
    for missing in ("campaigns", "turned", "quiet", "wide", "tracked"):
        if not hasattr(found, missing):
            setattr(found, missing, {})
    if not hasattr(found, "design"):
        found.design = SimpleNamespace(gamma=1.0, info=SimpleNamespace(optimum=1.0), closed_loop=np.zeros(0))
        found.design.closed_loop = SimpleNamespace(poles=lambda: np.zeros(1))
    return {claim.text: claim.verdict for claim in judged(claims.statements(found))}


def measured(rng, runs, scale=1.0, white=None, settled=30.0, effort=1.0):
    """Results of a campaign in which every index is `scale` of 0.1 deg, give or take 5 %."""

    def draw():
        return np.radians(0.1 * scale) * rng.uniform(0.95, 1.05, (runs, 3))

    white = rng.normal(size=(runs, 20, 9)) if white is None else white
    return Measured(
        ape=draw(), control_error=draw(), ake=draw(), pse=draw() / 3, slow=draw(),
        settling_time=settled * rng.uniform(0.95, 1.05, runs), torque_rms=draw(), effort=effort * draw(),
        momentum_peak=draw(), start=300.0, end=1000.0, delta_t=1.0, share=0.95, threshold=np.radians(1.0),
        white=white, nis=(white[..., :6] ** 2).sum(axis=-1), rows=np.full(white.shape[:2], 6.0),
    )  # fmt: skip


def campaigns(**scales):
    """Made-up campaigns of all configurations, those named of another scale."""
    rng, names = np.random.default_rng(1), study.ORDER
    flown = {n: measured(rng, 31, **scales.get(n.replace(" + ", "_").replace(" ", "_"), {})) for n in names}
    return {name: SimpleNamespace(results=r, index=np.arange(31), ok=np.ones(31, bool)) for name, r in flown.items()}


def test_verdicts_on_made_up_results():
    """Ten times the noise with the SVD, half the settling time with MPC: what is put in is found."""
    noisy, fast = {"scale": 10.0}, {"scale": 0.2, "settled": 8.0, "effort": 30.0}
    both = {"paper_EKF_MPC_velocity": fast, "paper_EKF_MPC_position": fast, "SVD_Hinf": noisy}
    found = SimpleNamespace(campaigns=campaigns(**both), controllers={}, window=300.0)
    found.turned = {name: found.campaigns[name] for name in study.TURNED}
    verdicts = verdicts_of(found)
    for text in (
        "The EKF configurations meet the AKE requirement, SVD + Hinf does not",
        "The EKF results in a better estimation than the SVD alone",
        "MPC has the smallest control error",
        "MPC reaches the desired attitude faster",
        "MPC costs more control",
        "EKF + Hinf meets the control error by a large margin, SVD + Hinf fails",
        "The Monte Carlo of EKF + Hinf meets all requirements with a few exceptions",
    ):
        assert verdicts[text] == "holds", text
    assert verdicts["EKF + Hinf is superior to the other configurations"] == "does not hold"
    assert verdicts["EKF + Hinf has a much smaller PSE than the other two"] == "does not hold"
    assert verdicts["Hinf costs less computation than MPC"] == "not measured"
    only_one = dict(both, paper_EKF_MPC_position={"scale": 3.0, "settled": 60.0})
    found.campaigns = campaigns(**only_one)
    assert verdicts_of(found)["MPC has the smallest control error"] == "depends on the form of the MPC"


def test_consistency_table_tells_a_filter_that_is_too_sure():
    rng = np.random.default_rng(2)
    right, sure = (s * rng.normal(size=(31, 70, 9)) for s in (1.0, 1.25))
    again = {"EKF + Hinf": right, "paper EKF + Hinf": sure}
    found = SimpleNamespace(campaigns={}, turned={}, window=300.0, again={
        name: SimpleNamespace(results=measured(rng, 31, white=w), ok=np.ones(31, bool)) for name, w in again.items()
    })  # fmt: skip
    rows = {row[0].split(",")[0].split(":")[0]: row for row in findings.filters(found).rows}
    assert rows["EKF"][5] == "consistent"
    assert rows["paper's"][5] == "too sure"
    assert float(rows["paper's"][1]) == pytest.approx(9 * 1.25**2, rel=0.05)
    assert float(rows["EKF"][3]) == pytest.approx(1, rel=0.05)


def test_summary_takes_the_stillest_of_those_that_meet_table_1():
    found = SimpleNamespace(campaigns=campaigns(EKF_PD={"scale": 0.5}, EKF_MPC_position={"scale": 0.1}))
    assert findings.summary(found).startswith("Take EKF + MPC position")
    found.campaigns = campaigns(EKF_PD={"scale": 0.5})
    assert findings.summary(found).startswith("Take EKF + PD")
    assert findings.summary(SimpleNamespace(campaigns={})) == ""


def test_every_table_and_figure_has_a_line():
    lines = [claim.source for claim in findings.counterparts()]
    found = SimpleNamespace(controllers={}, window=300.0)
    lines += [s.source for s in claims.statements(found_without_flights(found))]
    for kind, last in (("table", 5), ("figure", 16)):
        for number in range(1, last + 1):
            assert any(mentions(line, kind, number) for line in lines), (kind, number)
    for number in range(1, 28):
        assert any(mentions(line, "equation", number) for line in findings_sources()), number
    for claim in findings.counterparts():
        assert claim.why if claim.verdict == "left out" else claim.measured, claim.source


def found_without_flights(found):
    verdicts_of(found)
    return found


def findings_sources():
    return [claim.source for claim in findings.counterparts()]


def mentions(line, kind, number):
    """Whether "figures 7 to 9" is a line for figure 8."""
    for first, last in re.findall(rf"{kind}s? (\d+)(?:(?: to | and )(\d+))?", line):
        if int(first) <= number <= int(last or first):
            return True
    return False


def test_configurations_with_fewer_runs_are_compared_and_drawn():
    """An MPC is flown as often as its intervals need; pairs are those runs that both have."""
    found = SimpleNamespace(campaigns=campaigns(EKF_MPC_velocity={"scale": 0.2}))
    short = found.campaigns["EKF + MPC velocity"]
    short.results, short.index = measured(np.random.default_rng(3), study.FEW, scale=0.2), np.arange(study.FEW)
    assert study.indices_figure(found).axes
    pair = [claims.worst(found.campaigns[name].results, "ape") for name in ("EKF + MPC velocity", "EKF + Hinf")]
    assert claims.compared(*pair).runs == claims.compared(*pair[::-1]).runs == study.FEW
    assert claims.MEETS.met(claims.share(np.ones(study.FEW, bool)))
    assert not claims.MEETS.met(claims.share(np.ones(study.FEW - 1, bool)))
