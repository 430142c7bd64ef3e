// @ts-check
/** A table of any length: only the rows in view are there, the others are the height of two empty ones. */

import { h, setAttribute, setText } from "../dom.js";
import { inView, sorted } from "./rows.js";

/** Height of a row until one was measured, in pixel. */
const ROW_PX = 24;

/**
 * @template {{name: string}} R
 */
export class RowTable {
  /**
   * @param {{name: string, label: string, columns: import("./columns.js").Column<R>[], sort: string, down?: boolean,
   *   now_ms: () => number}} parts `name` of classes and hooks; `sort`: the column that it is sorted by at first
   */
  constructor({ name, label, columns, sort, down = false, now_ms }) {
    this.columns = columns;
    this.now_ms = now_ms;
    this.by = sort;
    this.down = down;
    /** @type {R[]} as they were given */
    this.given = [];
    /** @type {R[]} in their order */
    this.rows = [];
    /** @type {{row: HTMLElement, cells: HTMLElement[]}[]} those that are there */
    this.lines = [];
    this.rowPx = ROW_PX;
    this.frame = 0;
    this.heads = columns.map((column) => this.#head(column));
    this.above = spacer(columns.length);
    this.body = h("tbody", null);
    this.below = spacer(columns.length);
    this.table = h("table", { class: `fleet-table fleet-table-${name}` },
      h("caption", { class: "unseen" }, label),
      h("colgroup", null, columns.map((column) => h("col", { class: `fleet-col-${column.key}` }))),
      h("thead", null, h("tr", { "aria-rowindex": "1" }, this.heads)),
      this.above.part, this.body, this.below.part);
    this.element = h("div", { class: `fleet-scroll fleet-scroll-${name}`, tabindex: "0", role: "region", "aria-label": label, data: { testid: `fleet-${name}` },
      on: { scroll: () => this.#soon() } }, this.table);
    this.resized = new ResizeObserver(() => this.#soon());
    this.resized.observe(this.element);
    this.#showOrder();
  }

  /** Ends it. */
  stop() {
    cancelAnimationFrame(this.frame);
    this.resized.disconnect();
  }

  /** @param {R[]} rows */
  show(rows) {
    this.given = rows;
    const column = this.columns.find(({ key }) => key === this.by) ?? this.columns[0];
    this.rows = sorted(rows, column.by, this.down);
    this.draw();
  }

  /** What is in view, anew: words that count on. */
  draw() {
    const now_ms = this.now_ms();
    const [first, end] = inView(this.element.scrollTop, this.element.clientHeight, this.rowPx, this.rows.length);
    while (this.lines.length > end - first) this.lines.pop()?.row.remove();
    while (this.lines.length < end - first) this.#addLine();
    this.lines.forEach((line, k) => this.#fill(line, this.rows[first + k], first + k, now_ms));
    this.above.height(first * this.rowPx);
    this.below.height((this.rows.length - end) * this.rowPx);
    setAttribute(this.table, "aria-rowcount", String(this.rows.length + 1));
    this.#measure();
  }

  /** Rows are all of one height, which depends on the font: the first that is there says it. */
  #measure() {
    const height = this.lines[0]?.row.getBoundingClientRect().height;
    if (!height || Math.abs(height - this.rowPx) < 0.01) return;
    this.rowPx = height;
    this.#soon();
  }

  #soon() {
    this.frame ||= requestAnimationFrame(() => {
      this.frame = 0;
      this.draw();
    });
  }

  #addLine() {
    const cells = this.columns.map((column, k) => (k === 0 ? h("th", { scope: "row" }) : h("td", null)));
    const row = h("tr", null, cells);
    this.lines.push({ row, cells });
    this.body.append(row);
  }

  /**
   * @param {{row: HTMLElement, cells: HTMLElement[]}} line
   * @param {R} of
   * @param {number} index
   * @param {number} now_ms
   */
  #fill({ row, cells }, of, index, now_ms) {
    setAttribute(row, "aria-rowindex", String(index + 2));
    this.columns.forEach((column, k) => {
      const text = column.text(of, now_ms);
      setText(cells[k], text);
      // What is too long for its column is cut: the whole is shown beside the pointer.
      setAttribute(cells[k], "title", text.length > 12 ? text : null);
      const look = `${column.number ? "number " : ""}${column.look?.(of, now_ms) ?? ""}`.trim();
      setAttribute(cells[k], "class", look || null);
    });
  }

  /** @param {import("./columns.js").Column<R>} column */
  #head(column) {
    const button = h("button", { type: "button", class: "fleet-sort", on: { click: () => this.#sort(column.key) } }, column.label, h("span", { class: "fleet-arrow", "aria-hidden": "true" }));
    return h("th", { scope: "col", class: column.number ? "fleet-number" : null, data: { key: column.key } }, button);
  }

  /** @param {string} key */
  #sort(key) {
    this.down = this.by === key ? !this.down : false;
    this.by = key;
    this.#showOrder();
    this.element.scrollTop = 0;
    this.show(this.given);
  }

  #showOrder() {
    for (const head of this.heads) {
      const on = head.dataset.key === this.by;
      setAttribute(head, "aria-sort", on ? (this.down ? "descending" : "ascending") : null);
      setText(/** @type {Element} */ (head.querySelector(".fleet-arrow")), on ? (this.down ? "▼" : "▲") : "");
    }
  }
}

/** @param {number} columns */
function spacer(columns) {
  const cell = h("td", { colspan: columns });
  const part = h("tbody", { class: "fleet-spacer", "aria-hidden": "true", hidden: true }, h("tr", null, cell));
  const height = (/** @type {number} */ px) => {
    part.hidden = px <= 0;
    if (cell.style.height !== `${px}px`) cell.style.height = `${px}px`;
  };
  return { part, height };
}
