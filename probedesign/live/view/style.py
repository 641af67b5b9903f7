"""Appearance of the page beyond viser's: styles for light and dark ground, and the check of the age of its data."""

#: Colours of levels, readable on light and on dark ground.
STYLE = """
:root { --pd-good: #1b7f4b; --pd-fair: #9a5b00; --pd-bad: #b3261e; --pd-plain: #46525e; --pd-dim: #66717c; }
[data-mantine-color-scheme="dark"] { --pd-dim: #9aa5b0; }
.pd { padding: 4px 12px; font-size: 13px; line-height: 1.4; font-variant-numeric: tabular-nums; }
.pd table { width: 100%; border-collapse: collapse; }
.pd td { vertical-align: top; padding: 0; }
.pd td:first-child { color: var(--pd-dim); padding-right: 10px; white-space: nowrap; }
.pd-small { font-size: 12px; }
.pd-banner { color: white; border-radius: 6px; padding: 7px 10px; margin-bottom: 6px; font-size: 14px;
  font-weight: 600; }
.pd-banner.pd-good { background: var(--pd-good); } .pd-banner.pd-fair { background: var(--pd-fair); }
.pd-banner.pd-bad { background: var(--pd-bad); } .pd-banner.pd-plain { background: var(--pd-plain); }
td.pd-good, td.pd-fair, td.pd-bad { font-weight: 600; }
td.pd-good { color: var(--pd-good); } td.pd-fair { color: var(--pd-fair); } td.pd-bad { color: var(--pd-bad); }
[data-mantine-color-scheme="dark"] td.pd-good { color: #4fc78a; }
[data-mantine-color-scheme="dark"] td.pd-fair { color: #f0b050; }
[data-mantine-color-scheme="dark"] td.pd-bad { color: #ff8a80; }
.pd-old td { opacity: 0.45; } .pd-old td.pd-now { opacity: 1; }
.pd-rec { color: #d3302f; font-weight: 700; }
[data-mantine-color-scheme="dark"] .pd-rec { color: #ff6b6b; }
[data-mantine-color-scheme="dark"] .u-title { color: #c8d0d8; }
.u-title { font-size: 12px !important; line-height: 1.5; font-weight: 600; }
#pd-lost { display: none; position: fixed; z-index: 10000; top: 0; left: 0; right: 0; background: #b3261e;
  color: white; font: 600 15px sans-serif; padding: 10px 14px; text-align: center; }
.pd-lost #pd-lost { display: block; }
.pd-lost .pd { filter: grayscale(1); opacity: 0.45; } .pd-lost .pd-banner { background: var(--pd-plain) !important; }
.pd-lost canvas, .pd-lost .uplot { filter: grayscale(1); opacity: 0.45; }
"""

LOST_SECONDS = 3  #: Age from which the values of a page are lost [s]; the server renews them every second.
#: Marks all values as old when the server has not renewed them for a while.
SCRIPT = """
(function () {
  var beat = null, since = Date.now(), bar = null;
  setInterval(function () {
    var status = document.querySelector('[data-beat]'), now = Date.now();
    if (status && status.dataset.beat !== beat) { beat = status.dataset.beat; since = now; }
    var age = Math.round((now - since) / 1000), lost = beat !== null && age >= LOST_SECONDS;
    if (!bar && document.body) {
      bar = document.createElement('div'); bar.id = 'pd-lost'; bar.setAttribute('role', 'alert');
      document.body.appendChild(bar);
    }
    document.documentElement.classList.toggle('pd-lost', lost);
    if (lost) bar.textContent = 'Connection to the run lost: all values are ' + age + ' s old';
  }, 500);
})();
""".replace("LOST_SECONDS", str(LOST_SECONDS))
