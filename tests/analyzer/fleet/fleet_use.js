/* What somebody does with the report of a fleet, step by step; answers with what was seen. */
const one = (what, where = document) => where.querySelector(what);
const every = (what, where = document) => [...where.querySelectorAll(what)];
const told = {};
const press = (key) => document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
const map = one("table.map"), here = () => [one("#cell").textContent, document.activeElement.getAttribute("href")];

/* One stop for the tab key in each map; arrows go on from there, over days without a capture. */
told.stops = every("table.map").map((table) => every('td a[tabindex="0"]', table).length);
one('td a[tabindex="0"]', map).focus();
told.first = here();
for (const key of ["ArrowRight", "ArrowDown", "End", "Home"]) { press(key); told[key] = here(); }
press("ArrowLeft");
told.at_the_edge = here();
told.still_one = every('td a[tabindex="0"]', map).length;

/* The pointer tells the same. */
one("tbody tr td:last-child", map).dispatchEvent(new PointerEvent("pointerover", { bubbles: true }));
told.pointer = one("#cell").textContent;

/* The filter keeps some machines, in the map and in the cards. */
const form = one("#map .filter"), input = () => form.dispatchEvent(new Event("input", { bubbles: true }));
const left = () => [every("table.map tbody tr:not([hidden])").length, every("#machines li[data-name]:not([hidden])").length, one("output", form).textContent];
told.all = left();
form.words.value = "MACHINE-003"; input();
told.named = left();
told.opened = one("details.map-rest").open;
form.words.value = "";
one('[value="error"]', form).checked = false; input();
told.without_errors = left();
one('[value="error"]', form).checked = true; input();
told.again = left();

/* A link into what is closed opens it. */
const rest = one("#machines details.rest");
const last = every("#machines li[data-name]").pop();
location.hash = last.id;
dispatchEvent(new HashChangeEvent("hashchange"));
told.card_shown = last.checkVisibility() && rest.open;
one("#everything").click();
told.closed = every("details:not([open])").length;
