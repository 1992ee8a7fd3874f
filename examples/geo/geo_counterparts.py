"""The figures, equations and remarks of the thesis that state nothing a flight can judge, one line each."""

from plants import Claim, drawn, left_out

SKETCH = "a sketch or block diagram without figures; the equations behind it are flown"
TEXTBOOK = "textbook theory, not measured here; synth's own tests hold it"
DRIFT, FILTER, NEAR = "Free drift, figure 1", "The filter, figure 1", "Chapters 4 and 5, figure 1"


def counterparts() -> list[Claim]:
    """In the order of the thesis."""
    sketches = [
        ("1.1", "Local rotating coordinate system"),
        ("2.1", "Force of a mass element"),
        ("2.2", "Orbit parameters"),
        ("2.3", "Third body"),
        ("2.5", "The three orbiting planes"),
        ("2.6", "Spherical coordinates"),
        ("2.7", "First transformation"),
        ("2.8", "Second transformation"),
        ("2.11", "Simulink model"),
        ("3.1", "System with state observer"),
        ("3.2", "State observer"),
        ("4.1", "Optimal control scheme"),
        ("5.1", "General control configuration"),
        ("5.2", "General plant with weights"),
        ("5.3", "Uncertainty block"),
        ("5.4", "Pulling out the perturbations"),
        ("5.5", "M-Delta structure"),
        ("5.6", "Multiplicative input uncertainty"),
        ("5.7", "Configuration of the satellite's model"),
    ]
    pictures = [
        ("2.4", "Two days under J2", DRIFT),
        ("2.9", "Two days under the Moon", DRIFT),
        ("2.10", "Two days under the Sun", DRIFT),
        ("2.12", "Two days under all perturbations", DRIFT),
        ("3.3", "Measured and estimated x", FILTER),
        ("3.4", "Measured and estimated y", FILTER),
        ("3.5", "Measured and estimated z", FILTER),
        ("3.6", "Measured and estimated r2", FILTER),
        ("4.2", "Eigenvalues of the closed loop", "Chapters 4 and 5, figure 3"),
        ("4.3", "States with the regulator, from 1 m", NEAR),
        ("4.4", "Radius with the regulator, from 1 m", NEAR),
        ("5.8", "S against 1 / wP", "Chapters 4 and 5, figure 2"),
        ("5.9", "T against 1 / wI", "Chapters 4 and 5, figure 2"),
        ("5.10", "States with H-infinity, from 1 m", NEAR),
        ("5.11", "Radius with H-infinity, from 1 m", NEAR),
        ("6.1", "Regulator from 100 m", "Chapter 6, figure 1"),
        ("6.2", "Its forces", "Chapter 6, figure 2"),
        ("6.3", "H-infinity from 100 m", "Chapter 6, figure 1"),
        ("6.4", "Its forces", "Chapter 6, figure 2"),
        ("6.5", "Regulator from 1 km with 1 N", "Chapter 6, figure 3"),
        ("6.6", "Its forces", "Chapter 6, figure 5"),
        ("6.7", "H-infinity from 1 km with 1 N", "Chapter 6, figure 3"),
        ("6.8", "Its forces", "Chapter 6, figure 5"),
    ]
    remarks = [
        ("section 2.1", "Atmospheric drag is not significant", "no air model reaches 42 164 km; it is not flown"),
        (
            "section 2.2.1",
            "J2 changes node, perigee and mean anomaly",
            "of inclined and eccentric orbits; this one is neither",
        ),
        ("section 2.2.3", "Solar wind is 100 to 1000 times less than radiation", "the solar wind is not modelled"),
        ("equation 2.11", "Solar flux over the year, 1358 W/m2", "the flux is that of the Sun's distance of the day"),
        ("equation 2.13", "Cp = 0 for a black body", "an absorber takes all of the momentum: Cp = 1; read so"),
        ("equation 2.15", "J2 in the local frame, last term", "sin i cos i, not sin i; zero over the equator"),
        ("section 2.3.2", "The Earth's motion round the Sun is left out for a week", "ours moves, from an almanac"),
        (
            "section 2.3.2",
            "The 21st of June, Moon at 90 degrees from the Sun",
            "ours has a date with a year, and the Moon of that day",
        ),
        ("section 2.5", "Thrusters give 0.001 to 100 N", "taken as limits: 100 N and 1 N are flown"),
        ("equation 3.20", "A(4,5) = T and A(4,2) without c", "misprints: the equations (3.19) above have it right"),
        ("sections 4.1 to 4.3", "Hamiltonian, Riccati equation, theorems 1 and 2", TEXTBOOK),
        ("section 5.1.1", "Scaling by Dd, Du, De (5.3)", "values are not printed; (5.3) has y for d"),
        ("section 5.2", "Loop shaping and typical specifications", TEXTBOOK),
        ("section 5.3", "S + T = I, waterbed, bounds by zeros and poles (5.11 to 5.19)", TEXTBOOK),
        (
            "equation 5.15",
            "Weighted complementary sensitivity for several channels",
            "misprint: wT T and wT(p), not wP S",
        ),
        (
            "section 5.5.3",
            "mu for robust performance (5.38 to 5.40)",
            "the sum of (5.37) is measured; it is above 1 already",
        ),
        (
            "section 6.1",
            "Fuel flow is proportional to the force (6.1, 6.2)",
            "a definition: fuel is reported as delta-v",
        ),
        ("section 6.3", "H-infinity is more difficult to design", "an opinion"),
    ]
    return [
        *(left_out(f"figure {number}", text, SKETCH) for number, text in sketches),
        *(drawn(f"figure {number}", text, where) for number, text, where in pictures),
        *(left_out(source, text, why) for source, text, why in remarks),
    ]
