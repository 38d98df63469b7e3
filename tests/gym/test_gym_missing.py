"""Without Gymnasium its room says which extra is missing."""


def test_without_gymnasium_the_extra_is_named(run_python):
    code = (
        "import sys; sys.modules['gymnasium'] = None\n"
        "try: import adaptrack.gym\n"
        "except ImportError as missing: print(missing)"
    )
    assert "pip install 'adaptrack[gym]'" in run_python(code=code)
