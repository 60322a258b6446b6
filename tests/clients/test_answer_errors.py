from hypothesis import given
from hypothesis import strategies as st

from cspace_client.errors import MAX_CHARACTERS, printable, unusable


def test_a_server_s_words_stay_and_what_would_act_on_a_terminal_does_not() -> None:
    assert printable("größer als 7 µm") == "größer als 7 µm"
    assert printable("\x1b[31m\r\n\u202e\u2028\x85\ud800\0") == "?[31m???????"
    assert printable("a" * 5, 3) == "aa…"


@given(st.text(st.characters(), max_size=2 * MAX_CHARACTERS))
def test_no_text_is_long_or_leaves_its_line(text: str) -> None:
    shown = printable(text)
    assert shown.isprintable()
    assert len(shown) == min(len(text), MAX_CHARACTERS)


def test_an_unusable_answer_tells_what_came_in_plain_text() -> None:
    error = unusable("is odd", "1", "\x1b]0;title\x07")
    assert str(error).isprintable()
    assert "?]0;title?" in str(error)
