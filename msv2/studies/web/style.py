"""The style and the script that every HTML page of the studies contains. Neither needs another file or the network."""

from __future__ import annotations

STYLE = """\
* { box-sizing: border-box; }
body { font: 15px/1.45 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; color: #1c2430; background: #fff;
  max-width: 76em; margin: 0 auto; padding: 1em 1.2em 4em; }
h1 { font-size: 1.6em; line-height: 1.2; margin: .2em 0 .3em; }
h2 { font-size: 1.25em; margin: 1.6em 0 .4em; border-bottom: 2px solid #d7dee8; padding-bottom: .2em; }
h3, h4 { font-size: 1.05em; margin: 1.2em 0 .3em; }
p { margin: .5em 0; max-width: 60em; overflow-wrap: break-word; } a { color: #0b5cad; }
nav { margin: .8em 0 0; font-size: .93em; } nav a { margin-right: 1.1em; white-space: nowrap; }
button.fold { font: inherit; font-size: .93em; border: 1px solid #b9c4d2; border-radius: 4px; background: #f4f7fa;
  cursor: pointer; }
.summary { display: grid; grid-template-columns: minmax(0, 1.25fr) minmax(0, 1fr); gap: 1.2em; align-items: start; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.2em, 1fr)); gap: .6em; }
.card { background: #f4f7fa; border: 1px solid #dfe6ee; border-radius: 6px; padding: .45em .65em; }
.card b { display: block; font-size: 1.3em; line-height: 1.25; font-variant-numeric: tabular-nums; }
.card span { font-size: .84em; color: #46525f; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(17em, 100%), 1fr)); gap: 1.2em;
  align-items: start; }
.crops { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(10.5em, 46%), 1fr)); gap: .8em; }
figure { margin: 0; } figcaption { font-size: .9em; color: #333e4a; margin-top: .25em; }
.figures > figure { max-width: 27em; }
.figures.wide { grid-template-columns: repeat(auto-fit, minmax(min(21em, 100%), 1fr)); }
.figures h3 { margin: 0 0 .3em; }
img { max-width: 100%; height: auto; } figure img { width: 100%; display: block; border-radius: 3px; }
.plot { overflow-x: auto; }
.crops img { image-rendering: pixelated; }
details { border: 1px solid #dfe6ee; border-radius: 6px; margin: .5em 0; padding: 0 .8em; }
details[open] { padding-bottom: .7em; }
summary { cursor: pointer; padding: .45em 0; font-weight: 600; } summary:hover { color: #0b5cad; }
.table { overflow-x: auto; margin: .7em 0; max-height: 75vh; overflow-y: auto; border: 1px solid #dfe6ee; }
table { border-collapse: collapse; font-size: 13px; width: 100%; }
th, td { border-bottom: 1px solid #e4e9ef; padding: 3px 9px; text-align: left; vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number, td.short { white-space: nowrap; } td.words { min-width: 19em; } tbody tr:hover { background: #f4f7fa; }
th { cursor: pointer; background: #eef2f6; position: sticky; top: 0; vertical-align: bottom; }
th[aria-sort=ascending]::after { content: " \\25B2"; } th[aria-sort=descending]::after { content: " \\25BC"; }
pre { background: #f4f7fa; padding: .6em .8em; overflow-x: auto; font-size: 12.5px; }
code { background: #f0f3f6; padding: 0 .2em; overflow-wrap: anywhere; }
@media (max-width: 700px) { body { padding: .6em .8em 3em; } .summary { grid-template-columns: minmax(0, 1fr); }
  .cards { grid-template-columns: repeat(2, minmax(0, 1fr)); } h1 { font-size: 1.35em; }
  nav a { display: inline-block; padding: .2em 0; }
  .plot img { max-width: 720px; } }
"""
"""One column that fits 400 pixels of width, two beside each other from 700 on. Wide tables scroll in their own box."""

SCRIPT = """\
'use strict';
const value = cell => {
  const text = cell ? cell.textContent.trim() : '';
  const found = text.replace(/\\u2212/g, '-').match(/^[~+]?(-?\\d[\\d,]*(?:\\.\\d+)?(?:e[-+]?\\d+)?)/i);
  return found ? parseFloat(found[1].replace(/,/g, '')) : text.toLowerCase();
};
const compare = (a, b) => typeof a === typeof b ? (a < b ? -1 : a > b ? 1 : 0) : typeof a === 'number' ? -1 : 1;
const sort = head => {
  const table = head.closest('table'), body = table.tBodies[0], column = head.cellIndex;
  const down = head.getAttribute('aria-sort') === 'ascending';
  for (const other of table.tHead.rows[0].cells) other.removeAttribute('aria-sort');
  head.setAttribute('aria-sort', down ? 'descending' : 'ascending');
  const rows = [...body.rows].map((row, place) => [value(row.cells[column]), place, row]);
  rows.sort((a, b) => (down ? -1 : 1) * compare(a[0], b[0]) || a[1] - b[1]);
  body.append(...rows.map(row => row[2]));
};
for (const head of document.querySelectorAll('thead th')) {
  head.tabIndex = 0;
  head.title = 'sort by this column';
  head.addEventListener('click', () => sort(head));
  head.addEventListener('keydown', event => { if (event.key === 'Enter') sort(head); });
}
const unfold = () => {
  const place = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  for (let e = place; e; e = e.parentElement) if (e.tagName === 'DETAILS') e.open = true;
  if (place) place.scrollIntoView();
};
addEventListener('hashchange', unfold);
unfold();
for (const button of document.querySelectorAll('button.fold')) button.addEventListener('click', () => {
  const all = [...document.querySelectorAll('details')], open = all.some(e => !e.open);
  for (const e of all) e.open = open;
  button.textContent = open ? 'fold all sections' : 'unfold all sections';
});
"""
"""Sorts a table by the column whose head is clicked, unfolds the section that a link leads to, and folds all sections.

Numbers sort by value, and before words. Rows that are equal keep their order.
"""
