"""A case whose result becomes doubtful at some time: its crack runs into a rim that cannot break."""

CRACK_AT_THE_RIM = """
[lattice]
spacing = 1.0
lower = [-12.0, -10.0]
upper = [12.0, 10.0]
[model]
type = "elastic"
young = 1.0
nonlinear = true
critical_stretch = 0.02
[model.kernel]
horizon = 2.0
exponent = 1
[boundary]
all = { type = "lattice-pml", nodes = 8 }
[[crack]]
points = [[-5.0, 0.0], [5.0, 0.05]]
[[load]]
type = "body-force"
value = [0.0, "sign(y)*exp(-(abs(y)-3)**2)*exp(-(x/7)**8)"]
time = "0.012*min(t/8, 1)"
[run]
until = 40.0
[output]
every = 4.0
"""
