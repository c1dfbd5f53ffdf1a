"""What the browser runs (zoom, pan, loupe), and who may talk to the page's server."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

STYLE = """
<style>
  .nicegui-content { padding: 0; gap: 0; height: 100vh; }
  .pv-row { flex: 1 1 0; min-height: 0; align-items: stretch; overflow: hidden; }
  .pv-view { overflow: auto; height: 100%; background: #1d1f21; position: relative; flex: 1 1 0; min-width: 0;
    min-height: 0; }
  .pv-stage { position: relative; margin: auto; }
  .pv-stage > * { width: 100% !important; max-width: none !important; }
  .pv-stage img { width: 100%; display: block; user-select: none; }
  .pv-stage text { font-size: calc(var(--pv-pixel, 1) * 14px); stroke-width: calc(var(--pv-pixel, 1) * 2.5px); }
  .pv-zoomed img { image-rendering: pixelated; }
  .pv-loupe { position: absolute; z-index: 5; width: 190px; height: 190px; border: 2px solid #fff; border-radius: 8px;
    box-shadow: 0 2px 10px #000a; pointer-events: none; display: none; background: #000; }
  .pv-side { width: 350px; overflow-y: auto; flex: none; height: 100%; }
  .pv-side .q-expansion-item__content { padding: 0 4px; }
</style>
"""

SCRIPT = """
<script>
(() => {
  const LOUPE = 190, PART = 32;  // pixels of the screen, pixels of the image across it
  let zoom = 1, loupe = true, at = null, pan = null;
  const view = () => document.querySelector('.pv-view');
  const stage = () => document.querySelector('.pv-stage');
  const image = () => document.querySelector('.pv-stage img');

  function fit() {
    const v = view(), s = stage(), i = image();
    if (!v || !i || !i.naturalWidth) return;
    const room = v.getBoundingClientRect();
    const scale = Math.min((room.width - 2) / i.naturalWidth, (room.height - 2) / i.naturalHeight);
    s.style.width = i.naturalWidth * scale * zoom + 'px';
    s.style.height = i.naturalHeight * scale * zoom + 'px';
    s.classList.toggle('pv-zoomed', scale * zoom > 3);
    s.style.setProperty('--pv-pixel', 1 / (scale * zoom));
    document.body.dataset.zoom = zoom.toFixed(2);
  }
  function zoomTo(wanted, x, y) {
    const v = view(), before = stage().getBoundingClientRect();
    const across = (x - before.left) / before.width, down = (y - before.top) / before.height;
    zoom = Math.min(16, Math.max(1, wanted));
    fit();
    const after = stage().getBoundingClientRect();
    v.scrollLeft += after.left + across * after.width - x;
    v.scrollTop += after.top + down * after.height - y;
  }
  function magnify() {
    const v = view(), i = image();
    let c = document.querySelector('.pv-loupe');
    if (!c) {
      c = document.createElement('canvas');
      c.className = 'pv-loupe';
      c.width = c.height = LOUPE;
      v.parentElement.style.position = 'relative';
      v.parentElement.appendChild(c);
    }
    if (!loupe || !at || !i) { c.style.display = 'none'; return; }
    const r = i.getBoundingClientRect(), room = v.getBoundingClientRect();
    const u = (at[0] - r.left) / r.width * i.naturalWidth, w = (at[1] - r.top) / r.height * i.naturalHeight;
    const inside = at[0] > room.left && at[0] < room.right && at[1] > room.top && at[1] < room.bottom
      && u > 0 && w > 0 && u < i.naturalWidth && w < i.naturalHeight;
    c.style.display = inside ? 'block' : 'none';
    if (!inside) return;
    const near = at[0] - room.left < room.width / 2;
    c.style.left = near ? (room.width - LOUPE - 24) + 'px' : '12px';
    c.style.top = '12px';
    const g = c.getContext('2d');
    g.imageSmoothingEnabled = false;
    g.fillStyle = '#000';
    g.fillRect(0, 0, LOUPE, LOUPE);
    g.drawImage(i, u - PART / 2, w - PART / 2, PART, PART, 0, 0, LOUPE, LOUPE);
    g.strokeStyle = '#fff';
    g.beginPath();
    for (const [x, y, p, q] of [[0.5, 0, 0.5, 0.44], [0.5, 0.56, 0.5, 1], [0, 0.5, 0.44, 0.5], [0.56, 0.5, 1, 0.5]]) {
      g.moveTo(x * LOUPE, y * LOUPE);
      g.lineTo(p * LOUPE, q * LOUPE);
    }
    g.stroke();
  }
  const inView = event => event.target.closest && event.target.closest('.pv-view');
  addEventListener('wheel', event => {
    if (!inView(event)) return;
    event.preventDefault();
    zoomTo(zoom * Math.exp(-0.0015 * event.deltaY), event.clientX, event.clientY);
    magnify();
  }, {passive: false});
  addEventListener('mousemove', event => {
    if (pan) {
      view().scrollLeft = pan[0] - event.clientX;
      view().scrollTop = pan[1] - event.clientY;
    }
    at = inView(event) ? [event.clientX, event.clientY] : null;
    magnify();
  });
  addEventListener('mousedown', event => {
    if (inView(event) && event.button) {
      pan = [view().scrollLeft + event.clientX, view().scrollTop + event.clientY];
      event.preventDefault();
    }
  });
  addEventListener('mouseup', () => { pan = null; });
  addEventListener('contextmenu', event => { if (inView(event)) event.preventDefault(); });
  addEventListener('keydown', event => {
    if (event.target.closest('input, textarea') || event.ctrlKey || event.metaKey) return;
    const room = view().getBoundingClientRect();
    const [x, y] = at || [room.left + room.width / 2, room.top + room.height / 2];
    if (event.key === '+' || event.key === '=') zoomTo(zoom * 1.5, x, y);
    if (event.key === '-') zoomTo(zoom / 1.5, x, y);
    if (event.key === '0') zoomTo(1, x, y);
    if (event.key.toLowerCase() === 'l') loupe = !loupe;
    magnify();
  });
  addEventListener('resize', fit);
  addEventListener('load', event => { if (event.target === image()) fit(); }, true);
  new ResizeObserver(fit).observe(document.documentElement);
  setInterval(() => { if (image() && !stage().style.width) fit(); }, 100);
})();
</script>
"""
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]
NAMES = ("127.0.0.1", "localhost")


class SameOriginOnly:
    """ASGI middleware that refuses requests and websockets of other pages.

    ``Host`` must be this machine's, which a name that an attacker points to 127.0.0.1 is not; ``Origin``, which
    browsers send with every websocket and which pages cannot forge, must be the page's own where there is one.
    """

    def __init__(self, app: Application, port: int) -> None:
        self._app = app
        self._hosts = {f"{name}:{port}".encode() for name in NAMES}
        self._origins = {b"http://" + host for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is the page's own."""
        if scope["type"] not in ("http", "websocket") or self._is_own(scope):
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            headers = [(b"content-type", b"text/plain")]
            await send({"type": "http.response.start", "status": 403, "headers": headers})
            await send({"type": "http.response.body", "body": b"expected a request of the page itself\n"})
        else:
            # Closed before it is accepted: the handshake is answered with 403.
            await send({"type": "websocket.close", "code": 1008})

    def _is_own(self, scope: Scope) -> bool:
        hosts = [value for name, value in scope["headers"] if name == b"host"]
        origins = [value for name, value in scope["headers"] if name == b"origin"]
        return len(hosts) == 1 and hosts[0] in self._hosts and all(origin in self._origins for origin in origins)
