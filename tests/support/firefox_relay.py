"""Debian's Firefox as playwright launches it: started as an executable in the browser's
place.

Playwright drives a released Firefox by WebDriver BiDi, but asks for a command that
extended support releases do not know yet. This relay starts Firefox, passes all
messages on, and answers that command itself: nothing is emulated then, which no test
needs.
"""

import asyncio
import json
import re
import subprocess
import sys

from websockets.asyncio.client import connect
from websockets.asyncio.server import serve

UNKNOWN = "emulation.setMediaFeaturesOverride"
LISTENS = re.compile(r"WebDriver BiDi listening on (ws://\S+)")


def main():
    """Run Firefox with the words that are given until it ends or is ended."""
    command = [sys.argv[1], *sys.argv[2:]]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, errors="replace"
    ) as firefox:
        for line in firefox.stderr:
            if found := LISTENS.search(line):
                asyncio.run(relay(found[1], firefox))
                break
            sys.stderr.write(line)

    return firefox.returncode


async def relay(address, firefox):
    """Pass messages on between who connects here and Firefox, until Firefox ends."""

    async def talk(driver):
        async with connect(
            f"{address}{driver.request.path}", max_size=None, compression=None
        ) as browser:
            both = [
                asyncio.create_task(way(driver, browser)) for way in (forward, back)
            ]
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)

    async with serve(talk, "127.0.0.1", 0, max_size=None, compression=None) as server:
        port = server.sockets[0].getsockname()[1]
        sys.stderr.write(f"WebDriver BiDi listening on ws://127.0.0.1:{port}\n")
        sys.stderr.flush()
        # What it complains of is not wanted.
        await asyncio.to_thread(firefox.stderr.read)


async def forward(driver, browser):
    """From playwright to Firefox."""
    async for text in driver:
        message = json.loads(text)
        if message.get("method") == UNKNOWN:
            answer = {"type": "success", "id": message["id"], "result": {}}
            await driver.send(json.dumps(answer))
        else:
            await browser.send(text)


async def back(driver, browser):
    """From Firefox to playwright."""
    async for text in browser:
        await driver.send(text)


if __name__ == "__main__":
    sys.exit(main())
