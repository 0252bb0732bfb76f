"""A headless Chromium for tests of pages, cut off from the network."""

import base64
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_HINT = "install Debian's packages chromium and chromium-driver"


@contextmanager
def browser(width: int = 1280, height: int = 900) -> Iterator[webdriver.Chrome]:
    """A started browser that logs its console and all requests; it ends with the block.

    Without one the test is skipped, or fails where ISAS_REQUIRE_BROWSER=1 asks for it.
    """
    binary = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    driver = shutil.which("chromedriver")
    if binary is None or driver is None:
        reason = f"no {'chromedriver' if binary else 'Chromium'} on this machine: {_HINT}"
        if os.environ.get("ISAS_REQUIRE_BROWSER") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    opened = webdriver.Chrome(_options(binary, width, height), Service(driver))
    try:
        opened.execute_cdp_cmd("Network.enable", {})
        opened.execute_cdp_cmd(
            "Network.emulateNetworkConditions",
            {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0},
        )
        yield opened
    finally:
        opened.quit()


def _options(binary: str, width: int, height: int) -> webdriver.ChromeOptions:
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    arguments = ["--headless=new", f"--window-size={width},{height}", "--disable-dev-shm-usage"]
    # Names are not even looked up: whatever the page asked of the network would fail.
    arguments += ["--host-resolver-rules=MAP * ~NOTFOUND", "--disable-background-networking"]
    arguments += ["--disable-gpu", "--no-first-run", "--hide-scrollbars"]
    if os.geteuid() == 0:  # Chromium refuses its sandbox to root
        arguments.append("--no-sandbox")
    for argument in arguments:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return options


def console_errors(opened: webdriver.Chrome) -> list[str]:
    """Messages of the console that are errors, since the last call."""
    return [entry["message"] for entry in opened.get_log("browser") if entry["level"] == "SEVERE"]


def requested(opened: webdriver.Chrome) -> list[str]:
    """Addresses that pages asked for, without those inside the page (data:, blob:)."""
    events = [json.loads(entry["message"])["message"] for entry in opened.get_log("performance")]
    sent = [event for event in events if event["method"] == "Network.requestWillBeSent"]
    addresses = [event["params"]["request"]["url"] for event in sent]
    return [address for address in addresses if not address.startswith(("data:", "blob:"))]


def resize(opened: webdriver.Chrome, width: int, height: int) -> None:
    """The size of the page's view in CSS pixels, also one narrower than a window may be."""
    opened.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
    )


def screenshot(opened: webdriver.Chrome, path: Path) -> Path:
    """The whole page, from top to bottom, as a PNG."""
    shot = opened.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True})
    path.write_bytes(base64.b64decode(shot["data"]))
    return path
