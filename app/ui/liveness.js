// Says on every page that the server is gone or left behind, in the language of the page; the page itself cannot.
const LOOK_MS = 600
const ANSWER_MS = 900
// A screen that is drawn by itself every second and was not for so long shows what may no longer be so.
const LEFT_BEHIND_MS = 4000
let timer, gone

export default function ({ data }) {
  document.softcalTexts = data
  if (timer) return
  const bar = document.createElement("div")
  bar.id = "softcal-gone"
  bar.setAttribute("role", "alert")
  bar.hidden = true
  document.body.append(bar)
  const style = document.createElement("style")
  // Streamlit's own dialog comes after a quarter of a minute, in English, over everything.
  style.textContent = `
    #softcal-gone { position: fixed; inset: 0 0 auto 0; z-index: 2000000; background: #1B2733; color: #fff;
      border-bottom: 10px solid #FFC400; padding: 1.1rem 2rem; font: 600 1.6rem/1.35 var(--st-font, sans-serif); }
    body.softcal-is-gone [data-testid=stDialog] { display: none !important }
    body.softcal-is-gone .sc-card { filter: grayscale(1); opacity: 0.35 }`
  document.head.append(style)

  const show = (key) => {
    if (gone === key) return
    gone = key
    bar.hidden = !key
    bar.textContent = key ? document.softcalTexts[key] : ""
    document.body.classList.toggle("softcal-is-gone", Boolean(key))
  }
  const isConnected = () =>
    (document.querySelector("[data-test-connection-state]")?.dataset.testConnectionState ?? "CONNECTED") === "CONNECTED"
  const isLeftBehind = () =>
    document.querySelector(".st-key-scan-field, .st-key-line-actions") &&
    Date.now() - (document.softcalDrawn ?? Date.now()) > LEFT_BEHIND_MS
  // Streamlit calls the field of files a decoration and gives it a name: a reader that is told both leaves it out. The
  // words on its button are drawn by the style, which not every reader reads.
  const named = () => {
    for (const field of document.querySelectorAll("[data-testid=stFileUploaderDropzone]")) {
      field.removeAttribute("role")
      field.querySelector("button")?.setAttribute("aria-label", document.softcalTexts.files)
    }
  }
  const look = async () => {
    let answers = true
    try {
      const answer = await fetch(`${document.softcalTexts.health}`, {
        cache: "no-store", signal: AbortSignal.timeout(ANSWER_MS),
      })
      answers = answer.ok
    } catch {
      answers = false
    }
    named()
    show(!answers || !isConnected() ? "server" : isLeftBehind() ? "late" : "")
    timer = setTimeout(look, LOOK_MS)
  }
  timer = setTimeout(look, LOOK_MS)
}
