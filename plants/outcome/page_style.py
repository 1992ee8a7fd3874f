"""How a report looks: light and dark, phone, screen and paper."""

LIGHT = {
    "back": "#ffffff",
    "ink": "#1c2430",
    "soft": "#55606f",
    "line": "#d8dee6",
    "card": "#f5f7fa",
    "good": "#17703a",
    "bad": "#b42a24",
    "part": "#8a5a00",
    "link": "#1f5fa8",
}
DARK = {
    "back": "#12161c",
    "ink": "#e4e9f0",
    "soft": "#9aa7b8",
    "line": "#303a47",
    "card": "#1a2029",
    "good": "#56c27e",
    "bad": "#f28b82",
    "part": "#e0b050",
    "link": "#8fbdf5",
}


def _variables(theme: dict[str, str]) -> str:
    """The theme as CSS custom properties."""
    return " ".join(f"--{name}: {colour};" for name, colour in theme.items())


CSS = (
    f"""
:root {{ color-scheme: light dark; {_variables(LIGHT)} }}
@media screen and (prefers-color-scheme: dark) {{ :root {{ {_variables(DARK)} }} }}
"""
    + """
* { box-sizing: border-box; }
html { scroll-behavior: smooth; -webkit-text-size-adjust: 100%; }
@media (prefers-reduced-motion: reduce) { html { scroll-behavior: auto; } }
body { margin: 0 auto; max-width: 70rem; padding: 1.5rem 1rem 3rem; background: var(--back); color: var(--ink);
  font: 16px/1.55 system-ui, sans-serif; overflow-wrap: break-word; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; line-height: 1.3; margin: 2.4rem 0 .7rem; padding-top: .8rem;
  border-top: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 0 0 .5rem; }
p { max-width: 46rem; }
.subtitle { margin-top: 0; } .summary { font-size: 1.1rem; } .detail { color: var(--soft); font-size: .85em; }
.subtitle, figcaption, footer { color: var(--soft); }
a { color: var(--link); }
:focus-visible { outline: 3px solid var(--link); outline-offset: 2px; border-radius: .2rem; }
.skip { position: absolute; left: -100vw; }
.skip:focus { left: 1rem; top: .5rem; background: var(--back); padding: .4rem .8rem; }

nav ul { list-style: none; margin: 1rem 0 0; padding: 0; display: flex; flex-wrap: wrap; gap: .4rem; }
nav a { display: inline-block; padding: .25rem .7rem; border: 1px solid var(--line); border-radius: 1rem;
  font-size: .88rem; text-decoration: none; }
nav a:hover { background: var(--card); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(8.5rem, 1fr)); gap: .6rem; margin: 1.2rem 0; }
.tiles div { display: flex; flex-direction: column-reverse;
  justify-content: flex-end; padding: .7rem .9rem; background: var(--card);
  border-radius: .5rem; }
.tiles dt { color: var(--soft); font-size: .82rem; line-height: 1.3; }
.tiles dd { margin: 0; font-size: 1.5rem; font-weight: 600; font-variant-numeric: tabular-nums; line-height: 1.3; }

.scroll { overflow-x: auto; background:
  linear-gradient(to right, var(--back) 30%, transparent) 0 0 / 2.5rem 100% local,
  linear-gradient(to left, var(--back) 30%, transparent) 100% 0 / 2.5rem 100% local,
  linear-gradient(to right, var(--line), transparent) 0 0 / .8rem 100% scroll,
  linear-gradient(to left, var(--line), transparent) 100% 0 / .8rem 100% scroll; background-repeat: no-repeat; }
figure .scroll { background: none; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .4rem .9rem .4rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
thead th { font-weight: 600; color: var(--soft); white-space: nowrap; vertical-align: bottom; }
tbody th { font-weight: 500; }
.wide { width: auto; min-width: min(100%, 36rem); } .wide td { white-space: nowrap; }
.wide th, .wide td { padding-right: 1.4rem; }
.number { text-align: right; } .pad { visibility: hidden; }
td.pass, .verdict.pass { color: var(--good); } td.fail, .verdict.fail { color: var(--bad); }
.verdict.part { color: var(--part); } .verdict.none { color: var(--soft); }
.verdict { font-weight: 600; }
.bar { display: inline-block; width: 4.5rem; height: .5rem; margin-left: .4rem; border-radius: .25rem;
  background: var(--line); overflow: hidden; vertical-align: middle; }
.bar span { display: block; height: 100%; background: var(--good); }
.bar.fail span { background: repeating-linear-gradient(45deg, var(--bad) 0 3px, transparent 3px 5px); }

.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 19rem), 1fr)); gap: .9rem; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: .5rem; padding: .9rem 1rem;
  font-size: .9rem; }
.card dl { margin: 0; } .card p { color: var(--soft); margin: .6rem 0 0; }
.card dl div { display: flex; justify-content: space-between; gap: 1rem; padding: .15rem 0; }
.card dt { color: var(--soft); flex: none; } .card dd { margin: 0; text-align: right; overflow-wrap: anywhere;
  font-variant-numeric: tabular-nums; }
.definitions div { display: flex; gap: 1rem; padding: .15rem 0; } .definitions dt { flex: 0 0 5rem; font-weight: 600; }
.definitions dd { margin: 0; }
.files { padding-left: 1.1rem; margin: .7rem 0 0; }

.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 27rem), 1fr)); gap: 0 1rem;
  align-items: start; }
.figures:has(:checked) { display: block; }
figure { margin: 1.2rem 0 0; padding: .9rem; background: var(--card); border-radius: .5rem; }
figure svg { display: block; width: 100%; height: auto; color: var(--ink); }
figure:has(:checked) svg { width: 220%; max-width: none !important; }
.tool { font-size: .85rem; white-space: nowrap; margin-left: .6rem; }
label.tool { cursor: pointer; color: var(--link); }
figcaption { font-size: .9rem; margin-top: .5rem; max-width: 46rem; }
pre { overflow-x: auto; background: var(--card); padding: .8rem; border-radius: .5rem; font-size: .85rem; }
footer { font-size: .85rem; } footer h2 { font-size: 1rem; margin-top: 3rem; } footer ul { padding-left: 1.1rem; }

@media screen and (max-width: 44rem) {
  .wide tbody th { position: sticky; left: 0; background: var(--back); min-width: 7.5rem; max-width: 9rem; }
  figure { margin-inline: -.4rem; padding: .6rem; }
  .stacked, .stacked tbody, .stacked tr, .stacked th, .stacked td { display: block; width: 100%; }
  .stacked thead { position: absolute; clip-path: inset(50%); height: 1px; overflow: hidden; width: 1px; }
  .stacked tr { padding: .7rem 0; border-bottom: 1px solid var(--line); }
  .stacked th, .stacked td { border: 0; padding: .1rem 0; }
  .stacked tbody th { font-weight: 600; }
  .stacked td { display: flex; gap: .8rem; }
  .stacked .number { text-align: left; } .stacked .pad { display: none; }
  .stacked td::before { content: attr(data-label); flex: 0 0 5.2rem; color: var(--soft); font-weight: 400; }
}
@media print {
  .tool { display: none; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  nav, .skip { display: none; }
  .scroll { overflow: visible; }
  h2, h3 { break-after: avoid; }
  figure, .card, tr { break-inside: avoid; }
  a { color: inherit; }
}
"""
)
