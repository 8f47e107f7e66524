"""Expressions of case files: what they compute, and what they refuse."""

import math
import time

import numpy as np
import pytest

from farhorizon.errors import InputError
from farhorizon.inputs.expressions import FUNCTIONS, MAX_LENGTH, MAX_NESTING, Expression

X = np.linspace(-2.0, 2.0, 9)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-x**2", -(X**2)),
        ("2**-1*x", X / 2),
        ("x % 0.75", X % 0.75),
        ("+x - 3/4", X - 0.75),
        ("-1 <= x < 1", ((-1 <= X) & (X < 1)) * 1.0),
        ("x == 0", (X == 0) * 1.0),
        ("(x != 0) * 2", (X != 0) * 2.0),
        ("exp(-log(2)/9*x**2)", 2 ** (-(X**2) / 9)),
        ("log(e)*x + sin(pi)", X + math.sin(math.pi)),
        ("min(x, 1, -x)", np.minimum(np.minimum(X, 1), -X)),
        ("max(x, 0)", np.maximum(X, 0)),
        ("where(x > 0, log(x), 0)", [math.log(v) if v > 0 else 0.0 for v in X]),
        ("heaviside(x)", [1.0 if v >= 0 else 0.0 for v in X]),
        ("erf(x)", [math.erf(v) for v in X]),
        ("atan2(x, -1)", [math.atan2(v, -1) for v in X]),
        ("floor(x) + sign(x) + abs(x)", np.floor(X) + np.sign(X) + np.abs(X)),
        ("sinh(x) + cosh(x)", np.exp(X)),
        ("sin(x)/cos(x) - tan(x)", 0 * X),
        ("asin(x/2) + acos(x/2)", 0 * X + math.pi / 2),
        ("tanh(atan(x))", [math.tanh(math.atan(v)) for v in X]),
        ("sqrt(x)**2", np.where(X >= 0, X, np.nan)),
        ("  x\n +\n 1 ", X + 1),
        ("7", 0 * X + 7),
    ],
)
def test_values(text, expected):
    result = Expression(text, dim=1)(X)
    assert result.dtype == np.float64
    np.testing.assert_allclose(result, expected, rtol=1e-14, atol=1e-14)


def test_broadcasts_and_leaves_its_arguments_alone():
    x, y = np.arange(3.0)[:, None], np.arange(4)
    np.testing.assert_array_equal(Expression("x + 10*y + 100*t", 2)(x, y, t=2), x + 10 * y + 200)
    assert Expression("1", 2)(x, y).shape == (3, 4)
    assert Expression("t", 0)(t=np.arange(5)).shape == (5,)
    Expression("x", 2)(x, y)[...] = 7
    np.testing.assert_array_equal(x[:, 0], [0, 1, 2])
    with pytest.raises(InputError, match="takes 2 coordinates"):
        Expression("x", 2)(x)
    with pytest.raises(InputError, match="broadcast"):
        Expression("x", 2)(np.zeros(3), np.zeros(4))


def test_describes_itself():
    expression = Expression("sin(x)", 1)
    assert (expression.text, expression.dim, expression.uses_time, expression.uses_space) == ("sin(x)", 1, False, True)
    assert Expression("pi*t", 3).uses_time and not Expression("pi*t", 3).uses_space
    assert repr(expression) == "Expression('sin(x)', dim=1)"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x + y", "no y in 1 dimensions"),
        ("X", "did you mean x"),
        ("ppi*x", "did you mean pi"),
        ("foo", "known: x, t, pi, e"),
        ("arcsin(x)", "did you mean asin"),
        ("sine(x)", "did you mean sin"),
        ("foo(x)", "known: exp, log"),
        ("x(2)", "x is not a function"),
        ("2(x)", "only a function name"),
        ("exp", "needs its arguments"),
        ("exp(x, x)", "wrong number of arguments of exp"),
        ("min(x)", "at least 2"),
        ("where(x, 1)", "wrong number"),
        ("exp(x=1)", "named arguments"),
        ("exp(**x)", "named arguments"),
        ("min(x, *x)", "Starred"),
        ("x^2", r"write a power as \*\*"),
        ("x//2", "floor"),
        ("x.real", "attribute"),
        ("np.exp(x)", "attribute"),
        ("().__class__.__bases__", "attribute"),
        ("x[0]", "subscript"),
        ("'x'", "a string"),
        ("f'{x}'", "formatted string"),
        ("b'x'", "type bytes"),
        ("1j*x", "type complex"),
        ("True", "type bool"),
        ("...", "type ellipsis"),
        ("(lambda: 1)()", "only a function name"),
        ("lambda: 1", "lambda"),
        ("x if x else 1", "where"),
        ("x > 0 and x < 1", "multiply the conditions"),
        ("not x", "1 - condition"),
        ("x in x", "'in' is not allowed"),
        ("x is x", "'is' is not allowed"),
        ("[x for x in x]", "ListComp"),
        ("(x := 1)", ":="),
        ("1,5*x", "tuple"),
        ("{}", "Dict"),
        ("__import__('os')", "unknown function"),
        ("x # note", "comment"),
        ("", "syntax error"),
        ("x + ", "syntax error"),
        ("   x + * 2", "syntax error at character 8"),
        ("x\x00", "not an expression|syntax error"),
        ("x; x", "syntax error"),
        ("x = 1", "syntax error"),
        ("1e999", "double range"),
        ("1" + "0" * 400, "double range"),
        ("1" * 9000, "syntax error"),
        ("x" * (MAX_LENGTH + 1), "too long"),
        ("+".join(["x"] * (MAX_NESTING + 2)), "too deeply nested"),
        ("-" * (MAX_LENGTH - 1) + "x", "too deeply nested"),
        ("(" * 5000 + "x" + ")" * 4999, "syntax error|too deeply nested"),
        ("sin(" * 2000, "syntax error|too deeply nested"),
        (3, "is a text"),
    ],
)
def test_refuses(text, message):
    start = time.process_time()  # processor time, since others may share the machine
    with pytest.raises(InputError, match=message):
        Expression(text, dim=1)
    # One second is far more than the slowest refusal takes, and far less than a hang.
    assert time.process_time() - start < 1.0


def test_refuses_a_dimension_it_cannot_name():
    with pytest.raises(InputError, match="0 to 3"):
        Expression("1", 4)


def test_towers_of_powers_overflow_at_once():
    assert Expression("9**9**9**9", 0)() == np.inf
    assert np.isnan(Expression("(-8)**0.5", 0)())


def test_deepest_allowed_expression_evaluates_and_splits():
    text = "*".join(["(t+1)", *["x"] * (MAX_NESTING - 3)])
    expression = Expression(text, 1)
    assert expression(1.0, t=1.0) == 2.0
    space, factor = expression.separate()
    assert (space(1.0), factor(t=1.0)) == (1.0, 2.0)


@pytest.mark.parametrize(
    "text",
    [
        "exp(-(x**2+y**2))*sin(3*t)",
        "-sin(t)/(x*(t + 2)) * y",
        "1/((t+1)/(x*y))",
        "-(-x/-t)/-2",
        "x*y",
        "2*t**2",
        "3",
        "+(x + y)*(t < 1)*2/e**t",
    ],
)
def test_separates(text):
    expression = Expression(text, 2)
    space, factor = expression.separate()
    assert not space.uses_time and not factor.uses_space
    assert (space.dim, factor.dim) == (2, 0)
    x, y, t = np.random.default_rng(1).uniform(0.5, 2.0, (3, 20))
    np.testing.assert_allclose(space(x, y) * factor(t=t), expression(x, y, t=t), rtol=1e-13)
    # The texts of the parts agree with their values.
    np.testing.assert_array_equal(Expression(space.text, 2)(x, y), space(x, y))
    np.testing.assert_array_equal(Expression(factor.text, 0)(t=t), factor(t=t))


@pytest.mark.parametrize("text", ["exp(x + t)", "x + t", "x*sin(t)*(x - t)", "t**x", "-(x < t)"])
def test_does_not_separate(text):
    assert Expression(text, 2).separate() is None


def test_every_function_gives_one_number_for_numbers():
    for name, (_, least, _) in FUNCTIONS.items():
        assert Expression(f"{name}({', '.join(['0.5'] * least)})", 0)().shape == ()
