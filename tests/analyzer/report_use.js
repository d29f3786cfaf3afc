/* What an engineer does with a page, step by step; answers with what was seen after each step. */
const one = (what, where = document) => where.querySelector(what);
const every = (what, where = document) => [...where.querySelectorAll(what)];
const told = {};
const shown = () => one("#shown").textContent;
const firstPlot = one("figure.plot");
const bars = (svg) => every("rect", svg).filter((el) => !el.hasAttribute("display") && +el.getAttribute("width") > 0).length;
const press = (el, key) => el.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
const pointer = (type, el, x, y) => el.dispatchEvent(new PointerEvent(type, { bubbles: true, cancelable: true, clientX: x, clientY: y, button: 0, pointerType: "mouse" }));

told.whole = shown();
told.whole_path = one(".line", firstPlot).getAttribute("d").length;
const laneSvg = one("svg", every("#lanes .lane").pop());

/* A finding opens its stretch in all pictures. */
const link = one("#finding-1 [data-from]");
link.click();
told.finding = shown();
told.hash = location.hash;
told.cursor = one("#cursor").textContent;
told.flag_shown = !one('.flag[href="#finding-1"]').hidden;
told.flags_hidden = every(".flag").filter((el) => el.hidden).length;
told.bars = bars(laneSvg);
told.ticks = every("#lanes .axis .ticks > span").map((el) => el.firstChild.textContent);

/* Buttons and keys move the range. */
one('[data-zoom="out"]').click();
told.out = shown();
one('[data-zoom="on"]').click();
told.later = shown();
one('[data-zoom="all"]').click();
told.all = shown();
const hand = one(".hand", firstPlot);
hand.focus();
told.focused = document.activeElement === hand;
for (let i = 0; i < 40; i += 1) press(hand, "ArrowRight");
told.slider_blind = hand.getAttribute("aria-valuetext");
for (let i = 0; i < 10; i += 1) press(hand, "ArrowLeft");
told.slider = hand.getAttribute("aria-valuetext");
press(hand, "+");
told.key_zoom = shown();
press(hand, "0");
const timeHand = one("#lanes .hand");
press(timeHand, "Home");
told.states = timeHand.getAttribute("aria-valuetext");

/* Dragging over a picture chooses a stretch; the readings follow the pointer. */
const area = one(".area", firstPlot);
area.scrollIntoView();
const box = area.getBoundingClientRect(), y = box.top + box.height / 2;
pointer("pointerdown", area, box.left + box.width * 0.25, y);
pointer("pointermove", area, box.left + box.width * 0.5, y);
told.chosen = Boolean(one(".chosen"));
pointer("pointerup", area, box.left + box.width * 0.5, y);
told.dragged = shown();
told.chosen_after = Boolean(one(".chosen"));
area.dispatchEvent(new MouseEvent("dblclick", { bubbles: true }));
told.double = shown();

/* A line can be hidden. */
const several = every("figure.plot").find((figure) => every(".keys button", figure).length > 1);
if (several) {
  const button = one(".keys button", several);
  button.click();
  told.hidden = [button.getAttribute("aria-pressed"), one(".line, .area-of", several).classList.contains("off")];
  button.click();
}

/* The filter leaves what was asked for. */
const form = one(".filter");
if (form) {
  const seen = () => every(".stories > li").filter((el) => !el.hidden).map((el) => el.id);
  const change = (el, set) => { set(el); el.dispatchEvent(new Event("input", { bubbles: true })); };
  told.all_stories = seen().length;
  change(one('[value="warning"]', form), (el) => { el.checked = false; });
  told.no_warnings = seen().every((id) => one(`#${id}`).dataset.severity !== "warning");
  told.flags_off = every(".flag.warning:not(.off)").length;
  change(one('[value="warning"]', form), (el) => { el.checked = true; });
  change(one("select", form), (el) => { el.selectedIndex = 1; });
  told.of_node = [seen().length, one("output", form).textContent, one("details.rest") ? one("details.rest").open : null];
  change(one("select", form), (el) => { el.selectedIndex = 0; });
  change(one("[type=search]", form), (el) => { el.value = "BUS-OFF  7510h"; });
  told.searched = seen();
  change(one("[type=search]", form), (el) => { el.value = ""; });
}

/* A link into a closed part opens it; all tables open on request. */
const closed = one("details.node:not([open])");
one(`a[href="#${closed.id}"]`).click();
told.node_opened = closed.open;
one("#everything").click();
told.closed_left = every("main details:not([open])").length;
const only = one("#only-trouble");
if (only) { only.click(); told.lanes_left = every("#lanes .lane").filter((el) => el.checkVisibility()).length; only.click(); }
one('[data-zoom="all"]').click();
