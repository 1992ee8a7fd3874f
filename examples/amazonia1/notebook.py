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
# # Amazonia-1: state-dependent Riccati control, and what its weights do
#
# Romero and Souza (CILAMCE 2022; WSEAS 2022, doi 10.37394/23202.2022.21.9) bring the satellite Amazonia-1 to rest with
# three reaction wheels. The controller solves a Riccati equation at every sample, for the model factorised at the
# present state (SDRE). Here its weights are moved, and its H-infinity relative is led back to it. The studies
# themselves, with the papers' claims, are `amazonia1.py` and `amazonia1_region.py` beside this notebook.

# %%
import amazonia1 as study
import matplotlib.pyplot as plt
import numpy as np

from plants import amazonia1, campaign_plot, campaigns, run_plot
from synth import QuaternionModel, Sdre, SdreHinfStatic, quaternion_lqr

RUNS = 3  # random attitudes, rates and inertias
DURATION = 900.0  # s, of a flight

# %% [markdown]
# ## The weight of the torque
#
# With Q = 1 and R = r the linear gain grows as r^-1/2. Without limits, less weight on torque would always be faster.
# The wheels give 75 mN m each and turn with 6000 rpm at most, so it is not.

# %%
inertia = amazonia1.INERTIA - np.diag(amazonia1.WHEEL_INERTIA)
model = QuaternionModel.create(inertia)
factors = (0.1, 1.0, 10.0)
controllers = {f"SDRE, R = {r:g}": Sdre.create(model, amazonia1.PERIOD, R=r * np.eye(3)) for r in factors}
controllers |= {f"LQR, R = {r:g}": quaternion_lqr(inertia, amazonia1.PERIOD, R=r * np.eye(3)) for r in factors}


# %%
def fly(controllers, into):
    """Every controller from the same starts; run 0 begins at rest and is pushed."""
    campaigns(
        study.case,
        study.starts(RUNS, seed=0),
        {name: study.Shared(controller, DURATION) for name, controller in controllers.items()},
        into.campaigns,
        measure=study.measure,
        read=amazonia1.applied,
        keep=dict.fromkeys(controllers, (1,)),
    )


found = study.Study(DURATION)
fly(controllers, found)
print(study.table(found).text())

# %% [markdown]
# Three things to see in the table:
#
# - **Settling has an optimum.** At R = 0.1 the controller asks for more than the wheels can give, overshoots, turns
#   further than it has to and arrives later; at R = 10 it asks for less than they could give.
# - **Stiffness has none.** The angle that a constant torque leaves falls with the square root of R, since it is a
#   matter of the gain near the target alone. SDRE and LQR agree there to all digits shown: at the target they are the
#   same controller.
# - **SDRE and LQR are close** in all other columns, too, while the wheels are the bottleneck.

# %% [markdown]
# ## One manoeuvre
#
# First component of quaternion, rate and torque, for the first random start. At R = 0.1 the command is far beyond the
# 75 mN m of a wheel until the body has all but arrived; in the second row of pictures, what the wheels gave of it.

# %%
fig, axes = plt.subplots(3, 1, figsize=(9, 6.5), sharex=True, layout="constrained")
for r in factors:
    run = found.campaigns[f"SDRE, R = {r:g}"].kept[1]
    run_plot(run, axes, outputs=[1, 4], commands=[0], names=("q1", "wx, rad/s", "asked, N m"), label=f"R = {r:g}")

# %%
fig, axes = plt.subplots(1, 3, figsize=(11, 3.5), layout="constrained")
for name, flown in found.campaigns.items():
    run = flown.kept[1]
    style = "-" if name.startswith("SDRE") else "--"
    axes[0].semilogy(run.time, amazonia1.angles(run) / amazonia1.DEG, style, label=name)
    axes[1].plot(run.time, np.linalg.norm(run.inputs, axis=1), style)
    axes[2].plot(run.time, np.abs(run.states.wheels).max(axis=1) / amazonia1.RPM, style)
axes[0].legend(fontsize="small")
for ax, label in zip(axes, ("angle, deg", "torque given, N m", "fastest wheel, rpm"), strict=True):
    ax.set(xlabel="time, s", ylabel=label)

# %% [markdown]
# ## From H-infinity back to SDRE
#
# Glover and McFarlane's controller asks for the largest robustness to errors in the coprime factors; its level is
# `gamma_factor` times the best one. Near the best level the gain is large; far from it the equations become those of
# SDRE. The static form, without its observer, shows it: the larger the factor, the nearer to SDRE with R = 1.

# %%
robust = {
    f"SDRE + Hinf, static, factor {factor:g}": SdreHinfStatic.create(model, amazonia1.PERIOD, gamma_factor=factor)
    for factor in (1.02, 2.0, 10.0)
}
compared = study.Study(DURATION)
fly(robust, compared)
compared.campaigns["SDRE, R = 1"] = found.campaigns["SDRE, R = 1"]
print(study.table(compared).text())

# %%
fig, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
for name, flown in compared.campaigns.items():
    campaign_plot(flown, axes, results=["outcome.settling_time", "outcome.given"], label=name)
axes[0].set_xlabel("settling time, s")
_ = axes[1].set_xlabel("mean torque given, N m")

# %% [markdown]
# Each curve is the share of the runs that need no more than the value below it; its first step is run 0, which begins
# at rest. Factor 10 and SDRE coincide. The angle under a constant torque in the table tells the designs apart best:
# robustness near the optimal level is bought with gain, and gain is stiffness.
