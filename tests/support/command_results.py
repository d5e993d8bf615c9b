"""What a command has ended with: an answer, or one line that refuses."""


def answer(result):
    """Stdout of a call that succeeds and has nothing to complain of."""
    code, out, err = result
    assert code == 0, err
    assert err == ""
    return out


def output(result):
    """Stdout of a call that succeeds, whatever it tells of its progress."""
    code, out, err = result
    assert code == 0, err
    return out


def late_refusal(result):
    """The last line of a call that is refused after it has told how far it is."""
    code, out, err = result
    assert code == 2
    assert out == ""
    return err.splitlines()[-1]


def refusal(result):
    """The one line of a call that is refused, without the program's name."""
    code, out, err = result
    assert code == 2
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("place-rsus: ")
    return line.removeprefix("place-rsus: ")
