// A field that always listens: a scanner is a keyboard that types fast and ends with Enter, Tab or nothing at all.
const KEYSTROKE_MS = 45
const SILENCE_MS = 300
const SHORTEST = 2
// A scan that the server has not taken is sent again, but never so late that it would surprise anybody: then it is
// said that it was not taken. A start is late soonest, pressed or scanned, since something moves by it alone.
const AGAIN_MS = 1000
const isCommand = (text, command) => text.toUpperCase().replace(/\s/g, "").endsWith(`CMD:${command}`)
const SCAN_LATE_MS = 10000
// They live as long as the page: the field may be drawn anew in another place, and then this file is read again.
// `lost` was said not to be taken; it stands until the next scan.
const scans = (document.softcalScans ??= { waiting: [], lost: [], timer: undefined })

export default function ({ data, parentElement, setTriggerValue }) {
  const field = parentElement.querySelector("input")
  const live = parentElement.querySelector("[aria-live]")
  parentElement.querySelector("label span").textContent = data.label
  field.placeholder = data.placeholder
  if (live.textContent !== data.spoken) live.textContent = data.spoken

  document.softcalDrawn = Date.now()
  document.softcalShown = data.seen
  document.softcalTaken = data.taken
  // How far this clock is ahead of the server's: the drawing that came fastest says it best, and never too little.
  document.softcalAhead_ms = Math.min(document.softcalAhead_ms ?? Infinity, performance.now() - 1000 * data.at)
  const late = parentElement.querySelector("[role=alert]")
  const say = (lost) => {
    scans.lost = lost
    late.hidden = !lost.length
    late.textContent = lost.length ? data.late.replace("%", lost.map((scan) => scan.text).join(", ")) : ""
  }
  const late_ms = (text) => (isCommand(text, "START") ? 1000 * data.start_s : SCAN_LATE_MS)
  const again = () => {
    clearTimeout(scans.timer)
    scans.timer = setTimeout(() => document.softcalHand(), AGAIN_MS)
  }
  const hand = () => {
    clearTimeout(scans.timer)
    scans.timer = undefined
    const isOld = (scan) => Date.now() - scan.id > late_ms(scan.text)
    const open = scans.waiting.filter((scan) => scan.id > data.taken)
    const old = open.filter(isOld)
    if (old.length) say(old)
    scans.waiting.splice(0, scans.waiting.length, ...open.filter((scan) => !isOld(scan)))
    if (!scans.waiting.length) return
    setTriggerValue("scan", [...scans.waiting])
    again()
  }
  document.softcalHand = hand
  // A server that was only slow may have taken it after all, except a start: that one it lets go.
  say(scans.lost.filter((scan) => scan.id > data.taken || isCommand(scan.text, "START")))
  if (scans.waiting.length && scans.timer === undefined) again()
  const take = (text) => {
    say([])
    // A stop does not wait for a page that is being drawn; what it led to comes by the way of every scan.
    if (isCommand(text, "STOP")) {
      fetch(data.stop, { method: "POST", headers: { "x-softcal-key": "stop" }, body: data.station }).catch(() => {})
    }
    scans.waiting.push({
      id: Math.max(Date.now(), (scans.waiting.at(-1)?.id ?? 0) + 1),
      text,
      seen: document.softcalShown,
      // What is said not to be taken from then on is not taken by a busy server either.
      until_s: (performance.now() - document.softcalAhead_ms + late_ms(text)) / 1000,
    })
    hand()
  }
  const send = () => {
    clearTimeout(field.silence)
    const text = field.value
    field.value = ""
    field.strokes = []
    if (text.trim()) take(text)
  }

  // Runs again on every change of data: handlers are assigned, so that there is always one of each.
  field.onkeydown = (event) => {
    if (event.key === "Enter" || (event.key === "Tab" && field.value)) {
      event.preventDefault()
      send()
    } else if (event.ctrlKey && event.key === "]") {
      event.preventDefault()
      field.value += "\u001d"
    } else if (event.key === "Escape") {
      field.value = ""
    }
  }
  field.oninput = (event) => {
    const isFirst = field.value.length <= (event.data || "x").length
    const strokes = (field.strokes = isFirst ? [] : (field.strokes ?? []))
    // Some scanners hand all letters over at once.
    for (const _ of event.data || "x") strokes.push(performance.now())
    clearTimeout(field.silence)
    const count = strokes.length
    const isScanner = count >= SHORTEST && (strokes[count - 1] - strokes[0]) / (count - 1) < KEYSTROKE_MS
    if (isScanner) field.silence = setTimeout(send, SILENCE_MS)
  }

  const isOther = (element) => element && element.matches?.("input, textarea, select, [contenteditable], [role=combobox]")
  document.softcalScan?.abort()
  const listening = (document.softcalScan = new AbortController())
  document.addEventListener(
    "keydown",
    (event) => {
      const command = data.keys[event.key]
      if (command && event.repeat) {
        event.preventDefault() // A key that is held down was pressed once.
        return
      }
      if (command && !event.ctrlKey && !event.altKey && !event.metaKey) {
        event.preventDefault()
        take(`CMD:${command}`)
        return
      }
      const at = event.composedPath()[0]
      const isText = event.key.length === 1 && !event.ctrlKey && !event.altKey && !event.metaKey
      const isPress = event.key === " " && at.matches?.("button, a, summary")
      if (isText && !isPress && at !== field && !isOther(at)) field.focus()
    },
    { capture: true, signal: listening.signal },
  )
  document.addEventListener(
    "pointerup",
    (event) => {
      const path = event.composedPath()
      if (!path.some((element) => isOther(element))) setTimeout(() => field.focus({ preventScroll: true }), 150)
    },
    { signal: listening.signal },
  )
  if (!isOther(document.activeElement) && !document.activeElement?.matches("button, a")) {
    field.focus({ preventScroll: true })
  }
  return () => {
    listening.abort()
    // Drawn in another place, the field has handlers and a clock again already.
    if (document.softcalScan !== listening) return
    clearTimeout(scans.timer)
    scans.timer = undefined
  }
}
