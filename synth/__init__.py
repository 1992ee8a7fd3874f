"""Controller synthesis by convex optimisation, verified: from matrices to controllers that were measured.

The names below are imported when they are first used, so that ``import synth`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from synth.analysis.coprime import gang_of_four as gang_of_four
    from synth.analysis.coprime import ncfmargin as ncfmargin
    from synth.analysis.cover import ucover as ucover
    from synth.analysis.delayedmargins import allmargin as allmargin
    from synth.analysis.diskmargins import diskmargin_at as diskmargin_at
    from synth.analysis.gap import Gap as Gap
    from synth.analysis.gap import gapmetric as gapmetric
    from synth.analysis.gap import nugap as nugap
    from synth.analysis.hankel import Balanced as Balanced
    from synth.analysis.hankel import Gramians as Gramians
    from synth.analysis.hankel import balreal as balreal
    from synth.analysis.hankel import gramians as gramians
    from synth.analysis.hankel import hsvd as hsvd
    from synth.analysis.hankel import minreal as minreal
    from synth.analysis.mu import Mu as Mu
    from synth.analysis.mu import mussv as mussv
    from synth.analysis.norms import h2norm as h2norm
    from synth.analysis.norms import hinfnorm as hinfnorm
    from synth.analysis.norms import verify as verify
    from synth.analysis.reduce import Reduction as Reduction
    from synth.analysis.sampleddata import SampledNorm as SampledNorm
    from synth.analysis.sampleddata import sdh2norm as sdh2norm
    from synth.analysis.sampleddata import sdhinfnorm as sdhinfnorm
    from synth.analysis.stabilitymargins import Margins as Margins
    from synth.command.specification import Study as Study
    from synth.command.specification import read_study as read_study
    from synth.delivery.acceptance import Acceptance as Acceptance
    from synth.delivery.acceptance import Requirements as Requirements
    from synth.delivery.acceptance import accept as accept
    from synth.delivery.formats import export as export
    from synth.delivery.frequencyplots import bode as bode
    from synth.delivery.frequencyplots import nichols as nichols
    from synth.delivery.frequencyplots import nyquist as nyquist
    from synth.delivery.frequencyplots import sigma as sigma
    from synth.delivery.hankelplots import hsvplot as hsvplot
    from synth.delivery.marginplots import diskmarginplot as diskmarginplot
    from synth.delivery.modelfiles import read as read
    from synth.delivery.rounding import Rounding as Rounding
    from synth.delivery.rounding import rounding as rounding
    from synth.delivery.signatures import keygen as keygen
    from synth.delivery.signatures import sign as sign
    from synth.delivery.signatures import verify_signature as verify_signature
    from synth.delivery.timeplots import impulse as impulse
    from synth.delivery.timeplots import pzmap as pzmap
    from synth.delivery.timeplots import step as step
    from synth.equations.are import care as care
    from synth.equations.are import dare as dare
    from synth.errors import AssumptionError as AssumptionError
    from synth.errors import ExportError as ExportError
    from synth.errors import InfeasibleError as InfeasibleError
    from synth.errors import ModelError as ModelError
    from synth.errors import NumericalError as NumericalError
    from synth.errors import SpecificationError as SpecificationError
    from synth.errors import SynthError as SynthError
    from synth.errors import VerificationError as VerificationError
    from synth.predictive.fuel import FuelMpc as FuelMpc
    from synth.predictive.fuel import MinimumFuel as MinimumFuel
    from synth.predictive.fuel import free_motion as free_motion
    from synth.predictive.fuel import fuel_mpc as fuel_mpc
    from synth.predictive.fuel import minimum_fuel as minimum_fuel
    from synth.predictive.horizon import Mpc as Mpc
    from synth.predictive.horizon import mpc as mpc
    from synth.proof.boxcertificate import BoxCertificate as BoxCertificate
    from synth.proof.boxmargins import diskmargin as diskmargin
    from synth.proof.boxmargins import margin as margin
    from synth.proof.boxmargins import margins as margins
    from synth.proof.certify import Certificate as Certificate
    from synth.proof.stability import robstab as robstab
    from synth.proof.stability import stability_margin as stability_margin
    from synth.proof.worstcase import WorstCase as WorstCase
    from synth.proof.worstgain import wcgain as wcgain
    from synth.proof.worstgain import worst_gain as worst_gain
    from synth.regulators.antiwindup import AntiWindup as AntiWindup
    from synth.regulators.controller import Controller as Controller
    from synth.regulators.controller import LinearController as LinearController
    from synth.regulators.controller import proportional_derivative as proportional_derivative
    from synth.regulators.controller import state_feedback as state_feedback
    from synth.regulators.quaternion import quaternion_lqr as quaternion_lqr
    from synth.regulators.quaternion import quaternion_pd as quaternion_pd
    from synth.regulators.quaternion import quaternion_pid as quaternion_pid
    from synth.regulators.regulator import dlqr as dlqr
    from synth.regulators.regulator import lqg as lqg
    from synth.regulators.regulator import lqr as lqr
    from synth.regulators.regulator import lqrd as lqrd
    from synth.regulators.sampledlqg import Estimator as Estimator
    from synth.regulators.sampledlqg import kalmd as kalmd
    from synth.regulators.sampledlqg import lqgd as lqgd
    from synth.regulators.sdc import EulerModel as EulerModel
    from synth.regulators.sdc import MrpModel as MrpModel
    from synth.regulators.sdc import QuaternionModel as QuaternionModel
    from synth.regulators.sdre import Sdre as Sdre
    from synth.regulators.sdre import SdreHinf as SdreHinf
    from synth.regulators.sdre import SdreHinfPaperLiteral as SdreHinfPaperLiteral
    from synth.regulators.sdre import SdreHinfStatic as SdreHinfStatic
    from synth.regulators.sdre import SdreSampled as SdreSampled
    from synth.regulators.sequential import SequentialController as SequentialController
    from synth.synthesis.design import Design as Design
    from synth.synthesis.design import Info as Info
    from synth.synthesis.design import Shaping as Shaping
    from synth.synthesis.dkiteration import MuDesign as MuDesign
    from synth.synthesis.dkiteration import musyn as musyn
    from synth.synthesis.h2 import H2Design as H2Design
    from synth.synthesis.h2 import h2syn as h2syn
    from synth.synthesis.hinfinity import hinfsyn as hinfsyn
    from synth.synthesis.loopshaping import ncfsyn as ncfsyn
    from synth.synthesis.mixedsensitivity import augw as augw
    from synth.synthesis.mixedsensitivity import mixsyn as mixsyn
    from synth.synthesis.reduction import reduce as reduce
    from synth.synthesis.sampleddata import sdhinfsyn as sdhinfsyn
    from synth.synthesis.specifications import H2 as H2
    from synth.synthesis.specifications import Disc as Disc
    from synth.synthesis.specifications import GeneralisedH2 as GeneralisedH2
    from synth.synthesis.specifications import Hinf as Hinf
    from synth.synthesis.specifications import Peak as Peak
    from synth.synthesis.specifications import StrictlyProper as StrictlyProper
    from synth.synthesis.synthesize import Synthesis as Synthesis
    from synth.synthesis.synthesize import synthesize as synthesize
    from synth.systems.connect import feedback as feedback
    from synth.systems.connect import lft as lft
    from synth.systems.connect import series as series
    from synth.systems.continuous import d2c as d2c
    from synth.systems.delays import pade as pade
    from synth.systems.delays import pade_error as pade_error
    from synth.systems.generalized import GeneralizedPlant as GeneralizedPlant
    from synth.systems.parameters import Expression as Expression
    from synth.systems.parameters import ureal as ureal
    from synth.systems.sampled import c2d as c2d
    from synth.systems.statespace import StateSpace as StateSpace
    from synth.systems.statespace import system as system
    from synth.systems.uncertain import UncertainSystem as UncertainSystem
    from synth.systems.unmodelled import ultidyn as ultidyn

_HOME = {
    "Acceptance": "delivery.acceptance",
    "AntiWindup": "regulators.antiwindup",
    "AssumptionError": "errors",
    "Balanced": "analysis.hankel",
    "BoxCertificate": "proof.boxcertificate",
    "Certificate": "proof.certify",
    "Controller": "regulators.controller",
    "Design": "synthesis.design",
    "Disc": "synthesis.specifications",
    "Estimator": "regulators.sampledlqg",
    "EulerModel": "regulators.sdc",
    "ExportError": "errors",
    "Expression": "systems.parameters",
    "FuelMpc": "predictive.fuel",
    "Gap": "analysis.gap",
    "GeneralisedH2": "synthesis.specifications",
    "GeneralizedPlant": "systems.generalized",
    "Gramians": "analysis.hankel",
    "H2": "synthesis.specifications",
    "H2Design": "synthesis.h2",
    "Hinf": "synthesis.specifications",
    "InfeasibleError": "errors",
    "Info": "synthesis.design",
    "LinearController": "regulators.controller",
    "Margins": "analysis.stabilitymargins",
    "MinimumFuel": "predictive.fuel",
    "ModelError": "errors",
    "Mpc": "predictive.horizon",
    "MrpModel": "regulators.sdc",
    "Mu": "analysis.mu",
    "MuDesign": "synthesis.dkiteration",
    "NumericalError": "errors",
    "Peak": "synthesis.specifications",
    "QuaternionModel": "regulators.sdc",
    "Reduction": "analysis.reduce",
    "Requirements": "delivery.acceptance",
    "SampledNorm": "analysis.sampleddata",
    "Rounding": "delivery.rounding",
    "Sdre": "regulators.sdre",
    "SdreHinf": "regulators.sdre",
    "SdreHinfPaperLiteral": "regulators.sdre",
    "SdreHinfStatic": "regulators.sdre",
    "SdreSampled": "regulators.sdre",
    "SequentialController": "regulators.sequential",
    "Shaping": "synthesis.design",
    "SpecificationError": "errors",
    "StateSpace": "systems.statespace",
    "StrictlyProper": "synthesis.specifications",
    "Study": "command.specification",
    "SynthError": "errors",
    "Synthesis": "synthesis.synthesize",
    "UncertainSystem": "systems.uncertain",
    "VerificationError": "errors",
    "WorstCase": "proof.worstcase",
    "accept": "delivery.acceptance",
    "allmargin": "analysis.delayedmargins",
    "augw": "synthesis.mixedsensitivity",
    "balreal": "analysis.hankel",
    "bode": "delivery.frequencyplots",
    "c2d": "systems.sampled",
    "care": "equations.are",
    "d2c": "systems.continuous",
    "dare": "equations.are",
    "diskmargin": "proof.boxmargins",
    "diskmargin_at": "analysis.diskmargins",
    "diskmarginplot": "delivery.marginplots",
    "dlqr": "regulators.regulator",
    "export": "delivery.formats",
    "feedback": "systems.connect",
    "free_motion": "predictive.fuel",
    "fuel_mpc": "predictive.fuel",
    "gang_of_four": "analysis.coprime",
    "gapmetric": "analysis.gap",
    "gramians": "analysis.hankel",
    "h2norm": "analysis.norms",
    "h2syn": "synthesis.h2",
    "hinfnorm": "analysis.norms",
    "hinfsyn": "synthesis.hinfinity",
    "hsvd": "analysis.hankel",
    "hsvplot": "delivery.hankelplots",
    "impulse": "delivery.timeplots",
    "kalmd": "regulators.sampledlqg",
    "keygen": "delivery.signatures",
    "lft": "systems.connect",
    "lqg": "regulators.regulator",
    "lqgd": "regulators.sampledlqg",
    "lqr": "regulators.regulator",
    "lqrd": "regulators.regulator",
    "margin": "proof.boxmargins",
    "margins": "proof.boxmargins",
    "minimum_fuel": "predictive.fuel",
    "minreal": "analysis.hankel",
    "mixsyn": "synthesis.mixedsensitivity",
    "mpc": "predictive.horizon",
    "mussv": "analysis.mu",
    "musyn": "synthesis.dkiteration",
    "ncfmargin": "analysis.coprime",
    "ncfsyn": "synthesis.loopshaping",
    "nichols": "delivery.frequencyplots",
    "nugap": "analysis.gap",
    "nyquist": "delivery.frequencyplots",
    "pade": "systems.delays",
    "pade_error": "systems.delays",
    "proportional_derivative": "regulators.controller",
    "pzmap": "delivery.timeplots",
    "quaternion_lqr": "regulators.quaternion",
    "quaternion_pd": "regulators.quaternion",
    "quaternion_pid": "regulators.quaternion",
    "read": "delivery.modelfiles",
    "read_study": "command.specification",
    "reduce": "synthesis.reduction",
    "robstab": "proof.stability",
    "sdh2norm": "analysis.sampleddata",
    "sdhinfnorm": "analysis.sampleddata",
    "sdhinfsyn": "synthesis.sampleddata",
    "rounding": "delivery.rounding",
    "series": "systems.connect",
    "sigma": "delivery.frequencyplots",
    "sign": "delivery.signatures",
    "stability_margin": "proof.stability",
    "state_feedback": "regulators.controller",
    "step": "delivery.timeplots",
    "synthesize": "synthesis.synthesize",
    "system": "systems.statespace",
    "ucover": "analysis.cover",
    "ultidyn": "systems.unmodelled",
    "ureal": "systems.parameters",
    "verify": "analysis.norms",
    "verify_signature": "delivery.signatures",
    "wcgain": "proof.worstgain",
    "worst_gain": "proof.worstgain",
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str):
    """Import a public name from its module."""
    if name not in _HOME:
        raise AttributeError(f"module 'synth' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"synth.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names."""
    return [*globals(), *_HOME]
