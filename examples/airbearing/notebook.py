# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Air-bearing simulator: large slews, weights and noise
#
# A disk on an air bearing turns to (50, 20, -30) degrees with three reaction wheels: LQR against SDRE, with and without
# a Kalman filter, after a study of INPE's Space Mechanics and Control Division. Here the weights are moved; the study
# itself, with the paper's claims, is `airbearing.py`, and this notebook uses its parts.

# %%
import airbearing as study
import matplotlib.pyplot as plt
import numpy as np

from plants import airbearing, report, run_plot, simulate, simulate_many
from plants.missions.airbearing import DEG, INERTIA, PERIOD, TARGET, Q, R
from synth import EulerModel, SdreSampled, lqr, lqrd
from synth.regulators.regulator import sampled_cost

DURATION, STEADY = 240.0, 180.0  # s, of a flight, and where the slowest design is steady

# %% [markdown]
# ## A gain belongs to its period
#
# The weights of the paper make a fast loop in continuous time: poles near -270 rad/s. Held for the paper's 0.1 s this
# gain is unstable by a wide margin, whatever the model says of its phase. The regulator of the sampled plant, with the
# same weights, takes the hold into account and asks for less.

# %%
A, B = study.linear()
continuous, sampled = lqr(A, B, Q, R)[0], lqrd(A, B, Q, R, PERIOD)[0]
F, G, *_ = sampled_cost(A, B, Q, R, PERIOD)
rows = []
for name, gain in (("of continuous time", continuous), ("of sampled data", sampled)):
    radius = np.abs(np.linalg.eigvals(F - G @ gain)).max()
    rows.append((name, f"{gain[0, 0]:.2f}", f"{gain[0, 3]:.1f}", f"{radius:.3f}"))
print(
    report.text_table(("gain", "of roll, N m/rad", "of its rate, N m s/rad", f"spectral radius at {PERIOD:g} s"), rows)
)

# %% [markdown]
# ## LQR and SDRE on the paper's slew
#
# (The torque is drawn on a scale that is linear up to 1 mN m: a kick that sets the rate, and next to nothing after it.)
# Near the origin both are the same law. Over 50 degrees they are not: the LQR takes the body rates for the rates of the
# Euler angles, the SDRE solves the Riccati equation for the kinematics of the present attitude.

# %%
configured = study.configurations(DURATION)
pair = {name: simulate(*study.case(airbearing.case(), configured[name])) for name in (study.LQR, study.SDRE)}
fig, axes = plt.subplots(4, 1, figsize=(9, 8), sharex=True, layout="constrained")
for name, run in pair.items():
    names = ("roll, rad", "pitch, rad", "yaw, rad", "torque x, N m")
    run_plot(run, axes, outputs=[0, 1, 2], commands=[0], names=names, label=name)
axes[-1].set_xlim(0, 80)
_ = axes[-1].set_yscale("symlog", linthresh=1e-3)

# %%
rows = []
for name, run in pair.items():
    o = airbearing.outcome(run)
    rows.append((name, study.spelled(o.settling, ".1f"), study.spelled(100 * o.overshoot, ".1f"), f"{o.peak:.2f}"))
headers = ("controller", "settles to 2 %, s", "overshoot, %", "peak torque, N m")
print(report.text_table(headers, rows))

# %% [markdown]
# ## Moving the weight of the rates
#
# Q weighs angles with 1 and rates with q; R is small, so that the torque costs next to nothing. What limits the speed
# is q: the loop settles with a time constant of about sqrt(q) seconds, because a rate of 1 / sqrt(q) costs as much as
# an angle of one.

# %%
model = EulerModel.create(INERTIA, TARGET)
weights = (25.0, 100.0, 400.0)


def weighed(q):
    """The SDRE with the rates weighed by q."""
    return SdreSampled.create(model, PERIOD, Q=np.diag([1.0, 1, 1, q, q, q]), R=R)


def fly(noise, navigator):
    """The slew with every weight, one compiled batch."""
    one = airbearing.case(noise=noise)
    cases = [airbearing.manoeuvre(one, weighed(q), navigator, duration=DURATION) for q in weights]
    return dict(zip((f"q = {q:g}" for q in weights), simulate_many(cases), strict=True))


quiet = fly(0.0, airbearing.raw())
rows = []
for name, run in quiet.items():
    o = airbearing.outcome(run)
    rows.append((name, study.spelled(o.settling, ".1f"), study.spelled(100 * o.overshoot, ".1f"), f"{o.peak:.2f}"))
print(report.text_table(headers, rows))

# %%
fig, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
for name, run in quiet.items():
    run_plot(run, axes, outputs=[0], commands=[0], names=("roll, rad", "torque x, N m"), label=name)
axes[-1].set_xlim(0, 150)
_ = axes[-1].set_yscale("symlog", linthresh=1e-3)

# %% [markdown]
# ## With noise: what the filter is for
#
# The same three designs with the paper's noise, 0.2 degrees and 0.1 degrees per second, without and with the Kalman
# filter. The budget splits the pointing error into what is not known (true against estimated) and what is not held
# (estimated against desired), both as rms over axes and time from 180 s on.

# %%
noisy = {"raw": fly(1.0, airbearing.raw()), "filter": fly(1.0, airbearing.filtered(rates=True))}


def rms(values):
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


rows = []
for kind, runs in noisy.items():
    for name, run in runs.items():
        late = run.time >= STEADY
        true, known, desired = (a[late, :3] / DEG for a in (run.outputs, run.estimates, run.references))
        parts = [f"{rms(e):.3f}" for e in (true - desired, true - known, known - desired)]
        rows.append((kind, name, *parts, f"{1e3 * rms(run.inputs[late]):.2f}"))
print(report.text_table(("estimate", "design", "pointing", "not known", "not held, deg rms", "torque, mN m rms"), rows))

# %% [markdown]
# Raw measurements: every sample's noise goes to the wheels, and a slower loop (larger q) saves no torque, because the
# gain of the rate hardly depends on q. What the raw loop does not hold is the noise itself, which it is right not to
# follow. The filter lowers the error, and the torque by two orders of magnitude; with it q trades again: the fast
# design holds better, the slow one is quieter, and what is not known is a floor for both.

# %%
fig, axes = plt.subplots(2, 2, figsize=(10, 5), sharex=True, sharey="row", layout="constrained")
for column, (kind, runs) in zip(axes.T, noisy.items(), strict=True):
    for name, run in runs.items():
        late = run.time >= STEADY
        column[0].plot(run.time[late], (run.outputs[late, 0] - TARGET[0]) / DEG, label=name)
        column[1].semilogy(run.time[late], 1e3 * np.abs(run.inputs[late, 0]), label=name, lw=0.6)
    column[0].set_title(kind)
    column[1].set_xlabel("time, s")
axes[0, 0].set_ylabel("roll error, deg")
axes[1, 0].set_ylabel("|torque x|, mN m")
_ = axes[0, 0].legend(fontsize="small")
