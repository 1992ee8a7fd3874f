"""Studies as TOML texts, sound ones: to be damaged."""

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

MIXED = """
[plant]
dt = 1
num = [1, 0.5]
den = [1, 0.2, 0.1]
delay = 2
u = ["a"]
y = ["b"]
units = { a = "N" }
[synthesis]
problem = "mixedsensitivity"
[weights]
W1 = { zeros = [], poles = ["0.1"], gain = 2 }
W2 = { diag = [1] }
[specifications]
umin = [-1]
umax = inf
max_norm = 3.0
"""
