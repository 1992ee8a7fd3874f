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
# # A flexible satellite: which parameters break which design?
#
# A hub with panels that hardly damp, and four controllers of roll. Here the damping, the parameters and the size of the
# box are moved; the study itself, with flights over the box and certificates, is `flexible.py`, and this notebook uses
# its parts.

# %%
import flexible as study
import flexible_designs as designs
import flexible_flights as flights
import matplotlib.pyplot as plt
import numpy as np

from plants import Appendage, report, simulate
from synth import hinfnorm, stability_margin, worst_gain

BOX = designs.SPREAD  # percent
controllers = designs.designs(rounds=2)

# %% [markdown]
# ## Panels on a hub
#
# A finite-element model lists modes as they are on a hub that is held; on the free satellite they are faster, because
# the hub swings against them. `Appendage` knows both, and what the hub keeps of the inertia.

# %%
panels = Appendage.joined(flights.panels())
inertia = np.array([designs.ROLL, flights.PITCH, flights.YAW])
held, free = sorted(panels.frequencies), panels.free(inertia)
rows = [(f"{a:.3f}", f"{b:.3f}") for a, b in zip(held, free, strict=True)]
print(report.text_table(("hub held, rad/s", "free, rad/s"), rows))
print("inertia of the hub alone:", np.diag(panels.hub(np.diag(inertia))), "kg m2")

# %% [markdown]
# ## What the controllers look like
#
# The optimum of the nominal model has notches where the modes are, and the phase turns within them. The tuned
# controller of second order has none.

# %%
fig, axes = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
w = np.geomspace(0.01, 30, 600)
for name, K in controllers.items():
    law = designs.law(K)
    poles = 1j * w[:, None, None] * np.eye(law.n) - law.A
    values = (law.C @ np.linalg.solve(poles, np.broadcast_to(law.B, (len(w), law.n, 1))) + law.D)[:, 0, 0]
    axes[0].loglog(w, np.abs(values), label=name)
    axes[1].semilogx(w, np.degrees(np.unwrap(np.angle(-values))))
axes[0].legend(fontsize="small")
axes[0].set_ylabel("|u / J over the angle|, 1/s2")
axes[1].set_ylabel("phase lead, deg")
_ = axes[1].set_xlabel("frequency, rad/s")

# %% [markdown]
# ## Both sides of the truth
#
# `stability_margin` proves that no point of a box is unstable and shows one that is; `worst_gain` does so with the
# gain. What is proved holds between the samples and between the frequencies.

# %%
rows = []
for name, K in controllers.items():
    margin = stability_margin(designs.uncertain(BOX), K, tol=1e-2)
    stable = BOX * margin.lower > BOX
    gain = worst_gain(designs.uncertain(BOX), K, tol=1e-2) if stable else None
    rows.append((
        name, f"{BOX * margin.lower:.3g} %", f"{BOX * margin.upper:.3g} %",
        f"{gain.lower:.3f} to {gain.upper:.3f}" if gain else "unstable",
    ))  # fmt: skip
print(report.text_table(("controller", "stable to", "unstable at", f"worst gain within {BOX:g} %"), rows))

# %% [markdown]
# ## The counterexample flies
#
# Five times as far from nominal as the parameters that `stability_margin` returns, 2 %: the panels of the nonlinear
# satellite begin to swing. The tuned controller does not notice.

# %%
optimum = controllers[designs.NOMINAL]
found = stability_margin(designs.uncertain(BOX), optimum, tol=1e-2).parameters
far = {p: value + 5 * (found[p] - value) for p, value in study.PARAMETERS.items()}
one = flights.Case(far["J"], np.array([far["w1"], far["w2"]]), np.array(designs.DAMPING), np.radians([0.3, 0.0, 0.0]))
shared = flights.configurations(controllers, 200.0)
fig, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
for name in (designs.NOMINAL, designs.TUNED):
    run = simulate(*flights.case(one, shared[name]))
    axes[0].plot(run.time, 2 * run.outputs[:, 0] / flights.DEG, lw=0.8, label=name)
    axes[1].plot(run.time, run.states.modes[:, 0], lw=0.8)
axes[0].set_ylabel("roll, deg")
axes[1].set_ylabel("first mode, sqrt(kg) m")
axes[1].set_xlabel("time, s")
_ = axes[0].legend(fontsize="small")

# %% [markdown]
# ## Moving the damping of the model
#
# A notch is as narrow as the mode is damped. A design model with more damping than the satellite gives up what it gains
# from knowing the frequency, and survives: ten times the damping is enough for the whole box. More of it costs less
# gain, because the controller no longer answers to modes at all.

# %%
rows = []
for damping in (0.005, 0.01, 0.02, 0.05, 0.2, 0.7):
    K = designs.damped(damping)
    margin = stability_margin(designs.uncertain(BOX), K, tol=1e-2)
    nominal = hinfnorm(designs.uncertain().close(K).nominal)[0]
    rows.append((f"{damping:g}", f"{nominal:.3f}", f"{BOX * margin.lower:.3g} %"))
print(report.text_table(("damping of the design model", "gain, nominal", "stable to"), rows))

# %% [markdown]
# ## Gain along each parameter
#
# One parameter at a time is not the box, but shows which one hurts: for the optimum it is the first frequency,
# downwards, and the inertia, upwards. Where a line is missing the loop is unstable.

# %%
fig, axes = plt.subplots(1, 3, figsize=(10, 3.5), sharey=True, layout="constrained")
for ax, parameter in zip(axes, study.PARAMETERS, strict=True):
    for name, K in controllers.items():
        points = study.along(K, parameter, 31)
        ax.semilogy(points[:, 0], np.where(np.isfinite(points[:, 1]), points[:, 1], np.nan), label=name)
    ax.set_title(study.UNITS[parameter])
    ax.set_xlabel("from nominal, %")
axes[0].set_ylabel("gain")
axes[0].set_ylim(0.5, 30)
_ = axes[0].legend(fontsize="x-small")
