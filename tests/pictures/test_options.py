"""Arguments of `farhorizon plot` on the command line."""

import pytest

from farhorizon.cli.parser import command_parser


@pytest.mark.parametrize("limits", [("-1e-5", "2e-5"), ("-1", "1"), ("-2.E+3", "-.5e-2"), ("1", "2")])
def test_ranges_may_have_negative_powers_of_ten(limits):
    options = command_parser().parse_args(["plot", "a.h5", "--range", *limits, "--db"])
    assert options.range == [float(limit) for limit in limits] and options.db


def test_what_is_no_number_is_an_option_still(capsys):
    with pytest.raises(SystemExit):
        command_parser().parse_args(["plot", "a.h5", "--range", "-1e-5", "-e5"])
    assert "--range" in capsys.readouterr().err
