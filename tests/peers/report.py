"""Opens a report of ft-identify in a headless Chromium and prints what is on it as one JSON object.

    report.py CHROMIUM REPORT.html
"""

import json
import pathlib
import sys

from browser import Browser


def main():
    program, report = sys.argv[1:3]
    with Browser(program) as browser:
        browser.resize(1100, 900)
        browser.call("Page.navigate", url=pathlib.Path(report).resolve().as_uri())
        browser.wait_for("document.readyState === 'complete'")
        text = "document.querySelector('{}').innerText"
        seen = {name: browser.js(text.format(where)) for name, where in [("terms", "#terms"), ("said", "#say")]}
        seen["plots"] = browser.js("document.querySelectorAll('figure svg, figure canvas').length")
        seen["errors"] = browser.errors
    print(json.dumps(seen))


main()
