"""The `synth` command: look into files, accept, prove, export, compare, design and fly. `synth --help` says more.

Only `argparse` is imported here: help is instant. What a command does is in `synth.command.commands`.
"""

from __future__ import annotations

import argparse
import os
import sys

EPILOG = """\
exit codes:
  0    done, and everything required is met
  1    a controller fails its verification, a proof or a signature does not hold, or a requirement is missed
  2    bad input: options, files, models, or a controller that cannot leave in this form
  3    no controller exists: an assumption fails, or the level asked for cannot be reached
  4    no route to a solution worked (numerical trouble, or not enough memory)
  70   a bug of synth: an error that nobody foresaw; --debug shows where it arose
  130  interrupted
"""
PRECISIONS = ("double", "float32", "q15", "q31")
BUG = 70  # as sysexits.h has it


class Parser(argparse.ArgumentParser):
    """Errors in one line."""

    def error(self, message: str):
        """Say what is wrong and where help is."""
        from synth.checks import printable

        self.exit(2, printable(f"{self.prog}: {message} (see {self.prog} --help)\n"))


class Version(argparse.Action):
    """`--version`, looked up when asked for."""

    def __call__(self, parser, *_):
        """Print the version of the installed package."""
        from importlib import metadata

        print(f"synth {metadata.version('convex-synth')}")
        parser.exit()


def limits(text: str) -> list[float]:
    """Numbers between commas."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number, nor numbers between commas") from None


def add_limits(parser: argparse.ArgumentParser) -> None:
    """The options of saturation."""
    parser.add_argument("--umin", type=limits, metavar="U[,U...]", help="lower limit of the commands (--umin=-1,-2)")
    parser.add_argument("--umax", type=limits, metavar="U[,U...]", help="upper limit of the commands")


def make_parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    parser = Parser(
        prog="synth", description="Verified controllers: design, look, accept, export, compare, fly, sign.",
        epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--version", action=Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(
            name, help=text, description=text, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        sub.add_argument("--json", action="store_true", help="print JSON instead of text")
        sub.add_argument("--debug", action="store_true", help="show the traceback of an error")
        return sub

    info = command("info", "say what is in a file: order, channels, gamma, verified norm, provenance")
    info.add_argument("files", nargs="+", metavar="FILE", help="design, controller, plant or certificate (.json, .mat)")

    verify = command(
        "verify", "acceptance gate: hold, delay, rounding (bound proved), saturation and margins, measured again; or a "
        "certificate, proved again",
    )  # fmt: skip
    verify.add_argument("files", nargs="+", metavar="FILE", help="design, controller with --plant, or certificates")
    verify.add_argument("--key", metavar="PUB", help="whether any files are as they were signed, by this public key")
    verify.add_argument(
        "--design", metavar="FILE",
        help="with a certificate: whether it is of this design, or the one that an exported file (.h, .fmu) names",
    )  # fmt: skip
    verify.add_argument("--plant", metavar="FILE", help="generalised plant, or plain plant (its four-block norm)")
    verify.add_argument("--negative", action="store_true", help="with a plain --plant: the controller acts on r - y")
    verify.add_argument("--level", type=float, metavar="X", help="norm promised; a design on its own plant knows it")
    verify.add_argument("--dt", type=float, help="sampling time in s of a continuous design")
    add_limits(verify)
    verify.add_argument("--antiwindup", action="store_true", help="with limits: conditioned loop-shaping controller")
    verify.add_argument(
        "--as", choices=("controller", "fmu"), default=None,
        help="fmu: judge it as a co-simulation unit, whose commands come one sample later",
    )  # fmt: skip
    verify.add_argument("--precision", choices=PRECISIONS, help="of the exported numbers (default float32)")
    verify.add_argument(
        "--inputs", type=float, nargs="+", metavar="Y",
        help="|y| at most, for what rounding does (default: what all |w| <= 1 make of it)",
    )  # fmt: skip
    verify.add_argument("--overload", type=float, default=2.0, help="peak demand over the limits (default 2)")
    for option, unit in (
        ("ratio", "norm over the level (default 1.01)"), ("delay-ratio", "... with one sample of delay"),
        ("intersample-ratio", "... between the samples (default 1.05)"),
        ("gain-margin-db", "dB, one loop at a time"), ("phase-margin-deg", "degrees, one loop at a time"),
        ("delay-margin-samples", "samples, one loop at a time (default 1; 0 asks nothing)"),
        ("disk-margin", "alpha, all loops at once (default 0.34; 0 asks nothing)"), ("ncf-margin", "0 to 1"),
        ("rounding-ratio", "proved bound of what rounding does, over the peaks of the commands (default 0.01)"),
        ("box-margin", "size of an uncertain plant's box up to which the loop is proved stable (default 1)"),
        ("box-gain-ratio", "norm over the level at every point of the box"),
    ):  # fmt: skip
        verify.add_argument(f"--{option}", type=float, metavar="X", help=f"require: {unit}")

    certify = command("certify", "prove both bounds of a design's norm in ball arithmetic, and save the certificate")
    certify.add_argument("files", nargs=1, metavar="FILE", help="design (.json, .mat)")
    certify.add_argument("-o", "--output", metavar="FILE", help="certificate; default DESIGN.certificate.json")
    certify.add_argument("--lower", type=float, metavar="X", help="level to prove that no controller reaches it")
    certify.add_argument("--upper", type=float, metavar="X", help="level to prove the controller below")
    certify.add_argument("--intersample", type=float, metavar="X", help="level to prove between the samples")
    certify.add_argument("--delay", type=float, metavar="S", help="from sample to hold, taken in between them")
    certify.add_argument("--bits", type=int, metavar="N", help="precision to begin with (default 128)")
    certify.add_argument("--force", action="store_true", help="replace a file that exists")

    sign = command("sign", "sign any files with a private key: FILE.sig is written beside each")
    sign.add_argument("files", nargs="+", metavar="FILE", help="design, controller, certificate, C, FMU, ...")
    sign.add_argument("--key", required=True, metavar="KEY", help="private key, Ed25519 in PEM, as synth keygen writes")
    sign.add_argument("--passphrase", action="store_true", help="the key has one: ask for it")
    sign.add_argument("--force", action="store_true", help="replace a signature that exists")

    keygen = command("keygen", "make a pair of keys, NAME.key (private) and NAME.pub")
    keygen.add_argument("files", nargs=1, metavar="NAME")

    export = command("export", "write a controller for elsewhere: C99, FMU, MATLAB, JSON")
    export.add_argument("files", nargs=1, metavar="FILE", help="design or controller (.json, .mat)")
    export.add_argument("--format", required=True, choices=("c", "fmu2", "fmu3", "mat", "json"))
    export.add_argument("-o", "--output", required=True, metavar="DIR", help="folder, made if it is missing")
    export.add_argument("--name", default="controller", help="of files and C functions (default controller)")
    export.add_argument("--force", action="store_true", help="replace files that exist")
    export.add_argument("--allow-unstable", action="store_true", help="export a controller with unstable poles")
    export.add_argument("--accept", action="store_true", help="put a design through the gate first; the files say so")
    export.add_argument("--certificate", metavar="FILE", help="of the design: proved again, and named by its sha256")
    export.add_argument("--dt", type=float, metavar="S", help="with --accept: sampling time of a continuous design")
    export.add_argument("--float", action="store_true", help="single precision, as --precision float32")
    export.add_argument("--precision", choices=PRECISIONS, help="of C and FMU (default double)")
    export.add_argument(
        "--inputs",
        type=float,
        nargs="+",
        metavar="Y",
        help="|y| at most: bound of what rounding does (default 1)",
    )
    add_limits(export)
    export.add_argument("--antiwindup", action="store_true", help="with limits: conditioned loop-shaping controller")

    compare = command("compare", "compare designs: norms, margins, gaps, order, conditioning")
    compare.add_argument("files", nargs="+", metavar="FILE", help="designs (.json, .mat), the first is the reference")
    compare.add_argument("--plot", metavar="FILE", help="singular values, .svg or .png")

    design = command("design", "design from a TOML file, verify, and save")
    design.add_argument("files", nargs=1, metavar="STUDY.toml")
    design.add_argument("-o", "--output", metavar="FILE", help="design file, .json or .mat; default STUDY.json")
    design.add_argument("--force", action="store_true", help="replace a file that exists")

    init = command("init", "write templates of a spacecraft (spacecraft.toml) and of a design for it (design.toml)")
    init.add_argument("folder", nargs="?", default=".", metavar="FOLDER", help="made if it is missing (default .)")
    init.add_argument("--force", action="store_true", help="replace files that exist")

    fly = command("fly", "fly controllers on a spacecraft, dispersed, and report")
    fly.add_argument("spacecraft", metavar="SPACECRAFT.toml", help="as synth init writes it")
    fly.add_argument("files", nargs="+", metavar="CONTROLLER", help="design, controller or mpc (.json, .mat)")
    fly.add_argument("--report", metavar="DIR", help="folder for report.html, made if it is missing")
    fly.add_argument("--runs", type=int, metavar="N", help="flights of each controller (default 30)")
    fly.add_argument("--seed", type=int, default=0, help="of the dispersions and of the noise (default 0)")
    fly.add_argument("--duration", type=float, metavar="S", help="of a flight, instead of that in the file")
    fly.add_argument("--fast", action="store_true", help="four flights of each: a quick look")
    fly.add_argument("--positive", action="store_true", help="controllers without a sign act on y, not on r - y")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = make_parser().parse_args(arguments)
    try:
        from synth.command import commands

        return commands.run(options)
    except KeyboardInterrupt:
        print("synth: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except SystemExit:
        raise
    except BaseException as error:  # also a panic of a library that is not written in Python
        return bug(options, error)


def bug(options: argparse.Namespace, error: BaseException) -> int:
    """Say that the error is none of the user's, and what to do about it."""
    import traceback

    from synth.checks import printable

    if options.debug:
        print(printable("".join(traceback.format_exception(error))), end="", file=sys.stderr)
    told = printable(" ".join(f"{type(error).__name__}: {error}".split()))
    print(f"synth {options.command}: a bug of synth ({told}); please report it with what --debug says", file=sys.stderr)
    return BUG


if __name__ == "__main__":
    sys.exit(main())
