"""What the command line has to say to a mistake."""


def assert_one_line_of_help(outcome, phrases):
    code, out, err = outcome
    assert code == 2
    assert out == ""
    assert err.startswith("error: ") and err.endswith("\n") and err.count("\n") == 1, err
    for word in phrases:
        assert word in err
